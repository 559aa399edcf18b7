"""The plan in words and as JSON, for `inspect log` and `build --dry-run`."""

from __future__ import annotations

from typing import Any

from formats.readable import one_line
from mapmyworld.sensing.plan import Plan


def plan_lines(plan: Plan) -> list[str]:
    """The plan for people: one line a decision, then what to know and what is lost."""
    lines = ["plan:"]
    for decision in plan.decisions:
        choice = one_line(decision.choice or "none")
        lines.append(f"  {decision.role + ':':<14} {choice:<28} {decision.reason}")
        lines += [f"  {'':<14} not {other}" for other in decision.others]
    if plan.warnings:
        lines += ["notes:", *(f"  - {warning}" for warning in plan.warnings)]
    if plan.losses:
        lines += ["lost or assumed:", *(f"  - {loss}" for loss in plan.losses)]
    return lines


def plan_json(plan: Plan) -> dict[str, Any]:
    """The plan for programs."""
    return {
        "decisions": [
            {"role": d.role, "choice": d.choice, "reason": d.reason, "others": list(d.others)}
            for d in plan.decisions
        ],
        "base_frame": plan.base_frame,
        "planar": plan.planar,
        "clock": "log" if plan.use_log_time else "header",
        "base_from_lidar": plan.scan.base_from_lidar.tolist() if plan.scan else None,
        "base_from_camera": plan.camera.model.base_from_camera.tolist() if plan.camera else None,
        "warnings": list(plan.warnings),
        "losses": list(plan.losses),
    }
