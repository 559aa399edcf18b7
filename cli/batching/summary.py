"""What came of a batch, as text, JSON, JUnit and HTML; the same for the same maps."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from cli.batching.job import Result
from cli.exit_codes import EXIT_BAD_INPUT, EXIT_CHECK_FAILED, EXIT_PARTIAL

_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


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
    told = ", ".join(f"{count} {name}" for name, count in _counts(results).items())
    return "\n".join([*lines, told]) + "\n"


def as_junit(results: Sequence[Result]) -> str:
    """A JUnit report: a log without a map is an error, a requirement that is not met a failure."""
    counts = _counts(results)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<testsuite name="mapmyworld batch" tests="{len(results)}" '
        f'errors="{counts["failed"]}" failures="{counts["unmet"]}">',
    ]
    for result in results:
        lines.append(f'  <testcase classname="mapmyworld" name={_attribute(result.name)}>')
        told = _text("\n".join(_faults(result)))
        if result.status == "failed":
            first = result.message.splitlines()[0] if result.message else "no map"
            lines.append(f"    <error message={_attribute(first)}>{told}</error>")
        elif not result.passed:
            lines.append(f'    <failure message="requirements not met">{told}</failure>')
        elif told:
            lines.append(f"    <system-out>{told}</system-out>")
        lines.append("  </testcase>")
    return "\n".join([*lines, "</testsuite>"]) + "\n"


def as_html(results: Sequence[Result]) -> str:
    """One self-contained page."""
    from formats.report.page import Page, table

    counts = _counts(results)
    told = ", ".join(f"{count} {name}" for name, count in counts.items())
    page = Page("mapmyworld batch", told)
    rows = [
        (result.name, _verdict(result), _figures(result), "; ".join(_faults(result)))
        for result in results
    ]
    page.section("Logs", table(["log", "verdict", "map", "what is wrong"], rows))
    return page.html()


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


def _figure(value: float | None) -> str:
    return "no map to measure" if value is None else f"is {value:.6g}"


def _faults(result: Result) -> list[str]:
    unmet = [
        f"{check['require']} ({_figure(check['value'])})"
        for check in result.checks
        if not check["passed"]
    ]
    told = result.message.splitlines() if result.message else []
    return [*told, *unmet, *result.figures.get("losses", [])]


def _text(text: str) -> str:
    return escape(_NOT_XML.sub("?", text))


def _attribute(text: str) -> str:
    return quoteattr(_NOT_XML.sub("?", text))
