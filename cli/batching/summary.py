"""What came of a batch, as text, JSON, JUnit and HTML; the same for the same maps."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from cli.batching.job import Result
from cli.exit_codes import EXIT_BAD_INPUT, EXIT_CHECK_FAILED, EXIT_PARTIAL
from formats.check_results import Case, suite_xml


def exit_code(results: Sequence[Result]) -> int:
    """2 where a log gave no map, else 4 where a requirement fails, else 3 for partial maps."""
    if any(result.status == "failed" for result in results):
        return EXIT_BAD_INPUT
    if not all(result.passed for result in results):
        return EXIT_CHECK_FAILED
    return EXIT_PARTIAL if any(result.status == "partial" for result in results) else 0


def as_json(results: Sequence[Result]) -> dict[str, Any]:
    """Counts, and every result in the manifest's order."""
    return {**_counts(results), "logs": [asdict(result) for result in results]}


def as_text(results: Sequence[Result]) -> str:
    """One line a log, with what is wrong under it."""
    width = max((len(result.name) for result in results), default=0)
    lines = []
    for result in results:
        lines.append(f"{_verdict(result):<9}{result.name:<{width}}  {_figures(result)}".rstrip())
        lines += [f"{'':9}- {line}" for line in _faults(result)]
    reported = ", ".join(f"{count} {name}" for name, count in _counts(results).items())
    return "\n".join([*lines, reported]) + "\n"


def as_junit(results: Sequence[Result]) -> str:
    """A JUnit report: a log without a map is an error, a requirement that is not met a failure."""
    return suite_xml("mapmyworld batch", "mapmyworld", [_case(result) for result in results])


def _case(result: Result) -> Case:
    reported = "\n".join(_faults(result))
    if result.status == "failed":
        first = result.message.splitlines()[0] if result.message else "no map"
        return Case(result.name, "error", first, reported)
    if not result.passed:
        return Case(result.name, "failure", "requirements not met", reported)
    return Case(result.name, "passed", reported=reported)


def as_html(results: Sequence[Result]) -> str:
    """One self-contained page."""
    from formats.report.page import page_html, table

    counts = _counts(results)
    reported = ", ".join(f"{count} {name}" for name, count in counts.items())
    rows = [
        (result.name, _verdict(result), _figures(result), "; ".join(_faults(result)))
        for result in results
    ]
    logs = table(["log", "verdict", "map", "what is wrong"], rows)
    return page_html("mapmyworld batch", reported, [("Logs", logs)])


FORMS = {
    "summary.txt": as_text,
    "summary.json": lambda results: json.dumps(as_json(results), indent=1) + "\n",
    "summary.xml": as_junit,
    "summary.html": as_html,
}


def _counts(results: Sequence[Result]) -> dict[str, int]:
    found = Counter(result.status for result in results)
    unmet = sum(result.status != "failed" and not result.passed for result in results)
    return {name: found[name] for name in ("built", "partial", "failed")} | {"unmet": unmet}


def _verdict(result: Result) -> str:
    return result.status if result.status == "failed" or result.passed else "UNMET"


def _figures(result: Result) -> str:
    if not result.figures:
        return ""
    figures = result.figures
    return (
        f"{figures['nodes']} nodes, {figures['distance_m']:.1f} m in {figures['duration_s']:.0f} s"
    )


def _faults(result: Result) -> list[str]:
    unmet = [
        f"{check['require']} ({check.get('message', 'no map to measure')})"
        for check in result.checks
        if not check["passed"]
    ]
    reported = result.message.splitlines() if result.message else []
    return [*reported, *unmet, *result.figures.get("losses", [])]
