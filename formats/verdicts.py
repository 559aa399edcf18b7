"""Verdicts of a check as JUnit XML, which CI systems show, and as Markdown, for a comment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree


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
    failed = sum(not v.passed for v in verdicts)
    root = ElementTree.Element(
        "testsuite", name=_clean(suite), tests=str(len(verdicts)), failures=str(failed), errors="0"
    )
    for verdict in verdicts:
        case = ElementTree.SubElement(
            root, "testcase", classname="mapmyworld.check", name=_clean(verdict.requirement)
        )
        if not verdict.passed:
            failure = ElementTree.SubElement(case, "failure", message=_clean(verdict.message))
            failure.text = _clean(verdict.message)
        ElementTree.SubElement(case, "system-out").text = _clean(verdict.message)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _clean(text: str) -> str:
    """Without the characters that XML cannot hold."""
    return "".join(c for c in text if c in "\t\n" or (ord(c) >= 32 and c not in "\ufffe\uffff"))


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
        lines.append(f"| {mark} | `{_cell(v.requirement)}` | {value} | {_cell(v.message)} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").replace("`", "'").replace("<", "&lt;")
