"""Names from a log command no terminal: control characters are written out, here and there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from log_builders import Built, drive, write_mcap

from formats.check_results import Verdict, junit_xml
from formats.readable import one_line, readable
from formats.report.page import page_html, paragraph

EVIL = "/s\x1b[31m\x1b]0;title\x07\x9b2J\u202egnp\r\n  ok  all is well\x00"


def log(folder: Path) -> Path:
    def renamed(built: Built) -> Built:
        return (EVIL, *built[1:]) if built[0] == "/scan" else built

    path = folder / "evil.mcap"
    return write_mcap(path, [renamed(built) for built in drive(2, count=20, step_ns=10**8)])


@pytest.mark.parametrize("words", [["inspect", "log"], ["build", "--dry-run"]])
def test_no_name_of_a_log_reaches_the_terminal_raw(words: list[str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cli.main", *words, str(log(tmp_path))]
    done = subprocess.run(command, capture_output=True, check=False, timeout=300)
    reported = (done.stdout + done.stderr).decode()
    assert set(reported) & {*map(chr, range(32)), "\x7f", "\x9b", "\u202e"} <= {"\n"}
    lines = [line for line in reported.splitlines() if "/s\\x1b[31m" in line]
    assert lines
    assert all("\\u202egnp" in line for line in lines)
    assert not any(line.startswith("  ok  all is well") for line in reported.splitlines())


def test_a_page_holds_no_control_characters() -> None:
    text = page_html(EVIL, EVIL, [(EVIL, paragraph(EVIL))], {"topic": EVIL})
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", text)
    assert text.count("\\u202egnp") >= 5  # title twice, heading twice, paragraph


def test_a_suite_of_any_name_is_xml() -> None:
    from xml.etree import ElementTree

    text = junit_xml(EVIL + "\ufffe", [Verdict("nodes", "nodes > \uffff", 1.0, True, EVIL)])
    assert ElementTree.fromstring(text).tag == "testsuite"


def test_what_is_readable_stays() -> None:
    text = "Grüße aus 北京\n\tzwei Zeilen שלום"
    assert readable(text) == text
    assert one_line("/front/scan") == "/front/scan"
    assert one_line("a\nb\tc") == "a\\nb\\tc"
    long = "/camera/" + "x" * 100_000
    assert len(one_line(long)) < 200
    assert one_line(long).startswith("/camera/")
