"""The stage that reads all of tf and odometry and decides what of the log is used, and why."""

from __future__ import annotations

from collections.abc import Callable

from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.sensing import Plan, make_plan, survey_log
from mapmyworld.types import LogSource, MapStore, Progress


def plan_log(log: LogSource, config: Config, progress: Progress) -> Plan:
    """Which of the log's topics are used, and how."""
    plan = make_plan(survey_log(log, stage_of_log("survey", log, progress)), config.sensing)
    for d in plan.decisions:
        decided("plan", f"{d.role}: {d.choice or 'none'}: {d.reason}")
    for warning in plan.warnings:
        progress.note(warning)
    return plan


def stage_of_log(name: str, log: LogSource, progress: Progress) -> Callable[[int], None]:
    """Begins a stage that goes through the log; takes the stamp (ns) that it has come to."""
    info = log.info()
    start_ns = info.start_ns
    progress.stage(name, max(info.duration_s, 1e-9), "s")
    return lambda stamp_ns: progress.update((stamp_ns - start_ns) * 1e-9)


def note_plan(store: MapStore, plan: Plan) -> None:
    """Keeps in the store what was decided."""
    store.put(
        "plan",
        {
            "planar": plan.planar,
            "base_frame": plan.base_frame,
            "decisions": [
                {"role": d.role, "choice": d.choice, "reason": d.reason} for d in plan.decisions
            ],
            "warnings": plan.warnings,
            "losses": plan.losses,
        },
    )
