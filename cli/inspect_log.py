"""`mapmyworld inspect log`: contents, plan and diagnosis of a log."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import PATH, format_option
from cli.config import config_options
from cli.exit_codes import EXIT_PARTIAL
from cli.standard_streams import show_result
from formats.readable import one_line
from mapmyworld.errors import LogError
from mapmyworld.sensing.plan import Plan
from mapmyworld.types import LogInfo

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.diagnosis import Finding

_WIDEST = 60  # characters that the column of topics takes, at most


@click.command("log")
@click.argument("paths", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option("--quick", is_flag=True, help="No diagnosis.")
@config_options
@format_option
def log(
    paths: tuple[Path, ...],
    quick: bool,
    config: Config,
) -> None:
    """What is in LOG, which topics, frames and clock would be used and why, and what is wrong.

    \b
    mapmyworld inspect log drive.mcap
    mapmyworld inspect log drive.bag --format json
    """
    from formats.logs import open_log
    from mapmyworld.diagnosis import diagnose
    from mapmyworld.sensing import make_plan, survey_log

    source = open_log(paths)
    survey = survey_log(source)
    info = survey.info
    plan, failure = None, None
    try:
        plan = make_plan(survey, config.sensing)
    except LogError as error:
        failure = error
    findings = diagnose(source, plan, config) if plan and not quick else ()
    facts = {
        "log": info_json(info),
        "diagnosis": [asdict(finding) for finding in findings],
        "plan": plan_json(plan) if plan else None,
        "problems": [*info.problems, *([str(failure)] if failure else [])],
    }
    lines = info_lines(info) + (plan_lines(plan) if plan else [])
    show_result(facts, lines + finding_lines(findings))
    if failure is not None:
        raise failure
    if info.problems or (plan is not None and plan.losses):
        sys.exit(EXIT_PARTIAL)


def finding_lines(findings: Sequence[Finding]) -> list[str]:
    """Comparisons of sensors, each with its suggestion where it needs one."""
    lines = ["diagnosis:"] if findings else []
    for finding in findings:
        lines.append(f"  {'ok ' if finding.good else 'BAD'}  {finding.text}")
        lines += [f"       do: {finding.suggestion}"] if finding.suggestion else []
    return lines


def info_lines(info: LogInfo) -> list[str]:
    """A log's contents, laid out as the robotics tools do."""
    rows = [
        ("files", ", ".join(info.paths)),
        ("container", info.container),
        ("size", f"{info.size_bytes / 1e6:.2f} MB"),
        ("messages", str(info.message_count)),
        ("duration", f"{info.duration_s:.3f} s"),
        ("start", _time(info.start_ns)),
        ("end", _time(info.end_ns)),
        *info.details,
    ]
    lines = [f"{name + ':':<14} {value}" for name, value in rows]
    width = max((len(one_line(topic.topic)) for topic in info.topics), default=0)
    width = min(width, _WIDEST)
    lines.append("topics:")
    for topic in info.topics:
        rate = f" ({topic.frequency:.2f} Hz)" if topic.frequency else ""
        kind = f"{one_line(topic.type_name)} [{one_line(topic.encoding)}]"
        name = f"{one_line(topic.topic):<{width}}"
        lines.append(f"  {name}  {topic.count} msgs{rate} : {kind}")
    if info.problems:
        lines += ["damage:", *(f"  - {problem}" for problem in info.problems)]
    return lines


def _time(stamp_ns: int) -> str:
    seconds = stamp_ns * 1e-9
    utc = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    return f"{utc} ({seconds:.3f})"


def info_json(info: LogInfo) -> dict[str, Any]:
    """What `inspect log` reports about the file itself, as JSON can hold it."""
    return {
        "paths": list(info.paths),
        "container": info.container,
        "size_bytes": info.size_bytes,
        "messages": info.message_count,
        "start_ns": info.start_ns,
        "end_ns": info.end_ns,
        "duration_s": info.duration_s,
        "details": dict(info.details),
        "topics": [
            {
                "topic": t.topic,
                "type": t.type_name,
                "kind": str(t.kind),
                "encoding": t.encoding,
                "count": t.count,
                "frequency_hz": t.frequency,
            }
            for t in info.topics
        ],
    }


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
        "decisions": [asdict(decision) for decision in plan.decisions],
        "base_frame": plan.base_frame,
        "planar": plan.planar,
        "clock": "log" if plan.use_log_time else "header",
        "base_from_lidar": plan.scan.base_from_lidar.tolist() if plan.scan else None,
        "base_from_camera": plan.camera.model.base_from_camera.tolist() if plan.camera else None,
        "warnings": list(plan.warnings),
        "losses": list(plan.losses),
    }
