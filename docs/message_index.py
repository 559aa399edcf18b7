"""Every text that the program prints or shows, one row each, to be found by its beginning."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
from all_messages import ROOT, Message, _cell, _template, _texts, gathered
from generate import commands

from cli.main import group

# Packages whose texts people see: commands, the report, and notes about odometry and places.
_SHOWN = (
    "cli/", "formats/report/", "mapmyworld/odometry/", "mapmyworld/places/", "mapmyworld/stages/",
    "mapmyworld/types/wording", "mapmyworld/localisation/", "mapmyworld/sessions/",
    "mapmyworld/mapping/",
)  # fmt: skip
_PAGE_SCRIPT = "formats/report/assets/report.js"
_SHOWN_FILES = 3  # of a text that stands in several
_WORDS = re.compile(r"[A-Za-z]{2,}[,;:]? [A-Za-z]{2,}")  # two words, or it is no text
_LABEL = re.compile(r"[a-z]+: +\S")  # before a value
_CODE = re.compile(
    r"[<>{}]|\w=|^\w+\.\w+$|SELECT|INSERT|^[a-z]+-[a-z]+ |^\(?[#\d]|^use strict$"
)  # markup, keys, SQL


def index_page() -> str:
    """All rows as Markdown, in alphabetical order of what is literal in them."""
    helps = {one.text for one in _helps()}
    printed = (one for one in _printed() if one.text not in helps)
    places: dict[tuple[str, str], list[str]] = {}
    for one in sorted({*_messages(), *printed, *_helps(), *_on_the_page()}, key=_order):
        places.setdefault((one.text, one.kind), []).append(one.file)
    lines = [
        f"| {_cell(text)} | {kind} | {_in_short(files)} |" for (text, kind), files in places.items()
    ]
    return "\n".join([_HEAD, *lines]) + "\n"


def _in_short(files: list[str]) -> str:
    shown = ", ".join(f"`{file}`" for file in files[:_SHOWN_FILES])
    return shown if len(files) <= _SHOWN_FILES else f"{shown} and {len(files) - _SHOWN_FILES} more"


def _order(one: Message) -> tuple[str, str, str, str]:
    literal = re.sub(r"^[^A-Za-z]+", "", one.text)
    return literal.lower(), one.text, one.kind, one.file


def _messages() -> Iterator[Message]:
    yield from (one for one in gathered() if _WORDS.search(one.text))


def _printed() -> Iterator[Message]:
    """What functions and tables of the shown packages hold as text, without docstrings."""
    known = {(one.file, one.text) for one in gathered()}
    for path in sorted(ROOT.glob("*/**/*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(_SHOWN):
            continue
        for text in _texts_of(ast.parse(path.read_text("utf-8"))):
            if _is_text(text) and (name, text) not in known:
                yield Message(name, text, "text")


def _texts_of(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            inner = (n for n in ast.walk(node.value) if isinstance(n, ast.Constant | ast.JoinedStr))
            yield from map(_template, inner)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            yield from _texts(node)


def _helps() -> Iterator[Message]:
    """Help texts of commands and of their options."""
    for names, command in commands(group, ("mapmyworld",)):
        where = " ".join(names)
        yield Message(where, _first_sentence(command.help or command.short_help or ""), "help")
        for option in command.params:
            if isinstance(option, click.Option) and option.help:
                yield Message(where, " ".join(option.help.split()), "help")


def _first_sentence(text: str) -> str:
    return " ".join(text.partition("\n\n")[0].split())


def _on_the_page() -> Iterator[Message]:
    """What the report's script writes into the page."""
    script = Path(ROOT / _PAGE_SCRIPT).read_text("utf-8")
    for found in re.findall(r'"([^"\n]*)"|`([^`\n]*)`', script):
        text = re.sub(r"\$\{[^}]*\}", "...", "".join(found))
        if _is_text(text):
            yield Message(_PAGE_SCRIPT, " ".join(text.split()), "hover text")


def _is_text(text: str) -> bool:
    return bool(_WORDS.search(text) or _LABEL.match(text)) and not _CODE.search(text)


_HEAD = """# Every message, by its beginning

Written by `python docs/generate.py` from the code; do not edit. `...` stands for what varies. What
to do about errors, losses and notes is in [troubleshooting](troubleshooting.md), beside each.

| message | kind | from |
| --- | --- | --- |"""
