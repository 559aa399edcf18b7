"""Verdicts of a check as JUnit XML, which CI systems show, and as Markdown, for a comment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from formats.junit import Case, suite_xml


@dataclass(frozen=True, slots=True)
class Verdict:
    """One requirement, and what the map says."""

    name: str
    """The figure."""
    requirement: str
    """As a person would write it: "loop_closures >= 5"."""
    value: float | None
    passed: bool
    message: str
    """What it is, and by how much it misses."""


def junit_xml(suite: str, verdicts: Sequence[Verdict]) -> str:
    """One test case a requirement."""
    cases = [
        Case(v.requirement, "passed" if v.passed else "failure", v.message, v.message)
        for v in verdicts
    ]
    return suite_xml(suite, "mapmyworld.check", cases)


def markdown(title: str, verdicts: Sequence[Verdict]) -> str:
    """A table under a headline with the verdict."""
    failed = sum(not v.passed for v in verdicts)
    head = "all requirements hold" if not failed else f"{failed} of {len(verdicts)} do not hold"
    lines = [
        f"### {_cell(title)}: {head}",
        "",
        "| | requirement | is | |",
        "| --- | --- | --- | --- |",
    ]
    for v in verdicts:
        mark = "✅" if v.passed else "❌"
        value = "" if v.value is None or not math.isfinite(v.value) else f"{v.value:.6g}"
        lines.append(f"| {mark} | `{_code(v.requirement)}` | {value} | {_cell(v.message)} |")
    return "\n".join(lines) + "\n"


def _code(text: str) -> str:
    """Inside a code span nothing is markup but its own end, and the table's bar."""
    return text.replace("|", "\\|").replace("\n", " ").replace("`", "'")


def _cell(text: str) -> str:
    return _code(text).replace("<", "&lt;")
