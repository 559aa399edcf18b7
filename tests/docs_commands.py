"""Commands as the pages show them: found in their blocks, and run as the program would."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from unittest.mock import patch

from conftest import ROOT

from cli.main import main

_BLOCK = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Shown:
    """A command line in a page."""

    page: str
    line: str
    statuses: tuple[int, ...]
    """Exit codes that the page promises."""


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shown_in(page: Path) -> Iterator[Shown]:
    """Commands of a page's blocks: those called `run` or `fails-N` must end so, others well."""
    text = page.read_text(encoding="utf-8")
    for kind, body in _BLOCK.findall(text):
        whole = body.replace("\\\n", " ")
        promised = (0,) if kind == "run" else (0, 3)
        if kind.startswith("fails-"):
            promised = (int(kind.partition("-")[2]),)
        for line in whole.splitlines():
            # What follows three blanks or a mark is said about the command.
            command = re.split(r"   +|  #| #", line.strip())[0].strip()
            if command.startswith("mapmyworld "):
                yield Shown(page.name, command, promised)


def every_line() -> Iterator[tuple[str, list[str]]]:
    """Words of every command line in any page, in blocks and in running text."""
    for page in pages():
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        found = re.findall(r"^ *(?:mapping/bin/)?(mapmyworld [a-z][^\n#`]*)", text, re.MULTILINE)
        found += re.findall(r"`(mapmyworld [a-z][^`\n]*)`", text)
        for line in found:
            if "  the library" in line or "=" in line.split()[1] or " ..." in line or "|" in line:
                continue
            try:
                yield page.name, shlex.split(line.split("  ")[0])[1:]
            except ValueError:
                continue


def run(line: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command, run within this process."""
    out, err = StringIO(), StringIO()
    words, _, target = line.partition(" > ")
    with (
        patch.object(sys, "argv", shlex.split(words)),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
            status = 0
        except SystemExit as end:
            status = int(end.code or 0)
    if target:
        path = Path(target.strip()).expanduser()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(out.getvalue(), encoding="utf-8")
    return status, out.getvalue(), err.getvalue()
