"""Results as JUnit XML, which CI systems show; a check's as Markdown as well, for a comment."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


@dataclass(frozen=True, slots=True)
class Case:
    """One thing that was tried."""

    name: str
    verdict: Literal["passed", "failure", "error"]
    message: str = ""
    """In one line, why it did not pass."""
    reported: str = ""
    """All that there is to say."""


def suite_xml(suite: str, classname: str, cases: Sequence[Case]) -> str:
    """A suite of test cases."""
    counts = {
        kind + "s": str(sum(case.verdict == kind for case in cases))
        for kind in ("failure", "error")
    }
    root = ElementTree.Element(
        "testsuite", name=_clean(suite), tests=str(len(cases)), attrib=counts
    )
    for case in cases:
        item = ElementTree.SubElement(root, "testcase", classname=classname, name=_clean(case.name))
        if case.verdict != "passed":
            why = ElementTree.SubElement(item, case.verdict, message=_clean(case.message))
            why.text = _clean(case.reported)
        elif case.reported:
            ElementTree.SubElement(item, "system-out").text = _clean(case.reported)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _clean(text: str) -> str:
    """With a question mark for what XML cannot hold."""
    return _NOT_XML.sub("?", text)


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
