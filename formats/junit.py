"""Results as JUnit XML, which CI systems show."""

from __future__ import annotations

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
