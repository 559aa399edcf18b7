"""What holds for every command: -q, -v, and lists of files as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from database_samples import fill

from cli.main import group
from formats.database import open_store


def commands(inside: click.Group = group) -> Iterator[click.Command]:
    context = click.Context(inside)
    for name in inside.list_commands(context):
        command = inside.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command)
        else:
            yield command


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    return tmp_path / "map.db"


def run(*words: object) -> Result:
    return CliRunner().invoke(group, [str(word) for word in words], catch_exceptions=False)


def test_every_command_can_be_quiet_and_verbose() -> None:
    found = list(commands())
    assert len(found) > 30
    for command in found:
        names = [name for option in command.params for name in option.opts]
        for name in ("-q", "--quiet", "-v", "--verbose"):
            assert names.count(name) == 1, f"{command.name} {name}"


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e300", "-1"])
def test_no_option_takes_a_number_beyond_sense(text: str) -> None:
    """NaN as a cell's side gave a grid of one, and as a start a traceback."""
    kinds = [
        option.type
        for command in commands()
        for option in command.params
        if isinstance(option.type, click.types.FloatParamType)
    ]
    assert len(kinds) >= 8
    for kind in kinds:
        with pytest.raises(click.BadParameter):
            kind.convert(text, None, None)


def test_quiet_leaves_out_notes_but_no_data(filled: Path) -> None:
    picture = filled.with_name("graph.png")
    words = ("inspect", "graph", filled, "--image", picture)
    said, silent = run(*words), run(*words, "-q")
    assert f"drew {picture}" in said.stderr
    assert silent.stderr == ""
    assert silent.stdout == said.stdout


def test_verbose_says_on_stderr_what_it_took(filled: Path) -> None:
    said = run("inspect", "map", filled, "-v")
    took = r"inspect map: \d+\.\d s, \d+\.\d CPU s, \d+ MB at most\n"
    assert re.search(took, said.stderr)
    assert said.stdout == run("inspect", "map", filled).stdout


def test_exports_list_their_files_as_json(filled: Path) -> None:
    told = json.loads(run("export", "grid", filled, "--format", "json").stdout)
    files = [str(filled.with_suffix(ending)) for ending in (".pgm", ".yaml")]
    assert told == {"files": files, "problems": []}
    text = run("export", "grid", filled, "--format", "text").stdout
    assert text.split() == files


def test_what_cannot_be_read_is_told_by_its_reader() -> None:
    """By click it would be wrong usage, in three lines."""
    kinds = [option.type for command in commands() for option in command.params]
    paths = [kind for kind in kinds if isinstance(kind, click.Path)]
    assert len(paths) > 50
    assert not any(kind.readable for kind in paths)
