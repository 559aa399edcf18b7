"""What holds for every command: -q, -v, and lists of files as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from conftest import ROOT
from database_samples import fill

from cli.main import group
from formats.database import open_store
from mapmyworld.errors import LogError


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
    reported = json.loads(run("export", "grid", filled, "--format", "json").stdout)
    files = [str(filled.with_suffix(ending)) for ending in (".pgm", ".yaml")]
    assert reported == {"files": files, "problems": []}
    text = run("export", "grid", filled, "--format", "text").stdout
    assert text.split() == files


def test_what_cannot_be_read_is_reported_by_its_reader() -> None:
    """By click it would be wrong usage, in three lines."""
    kinds = [option.type for command in commands() for option in command.params]
    paths = [kind for kind in kinds if isinstance(kind, click.Path)]
    assert len(paths) > 50
    assert not any(kind.readable for kind in paths)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["biuld"], "Did you mean 'build'?"),
        (["inspct"], "Did you mean 'inspect'?"),
        (["inspect", "grpah"], "Did you mean 'graph'?"),
        (["build", "x.bag", "--resolution", "0.1"], "give --set mapping.resolution=VALUE"),
        (["build", "x.bag", "--resum"], "Did you mean '--resume'?"),
    ],
)
def test_what_is_mistyped_is_reported(words: list[str], said: str) -> None:
    done = CliRunner().invoke(group, words)
    assert said in done.stderr
    assert done.stderr.count("--resume") == said.count("--resume")


def test_american_spelling_is_understood(filled: Path, tmp_path: Path) -> None:
    for name in ("localize", "optimize"):
        assert run(name, "--help").stdout == run(name.replace("ize", "ise"), "--help").stdout
    path = filled.with_name("path.tum")
    assert run("export", "trajectory", filled, "--which", "optimized", "-o", path).exit_code == 0
    assert "neighbour >= 0" in run("check", filled, "--require", "neighbor >= 0").stdout
    words = ["compare", str(tmp_path / "no.bag"), "--methods", "neighbor", "-o", str(tmp_path)]
    assert "unknown" not in CliRunner().invoke(group, words).output


def test_inspect_shows_a_file_as_the_log_or_the_map_that_it_is(filled: Path) -> None:
    bag = ROOT / "sample_logs" / "hall.bag"
    assert run("inspect", bag, "--quick").stdout == run("inspect", "log", bag, "--quick").stdout
    assert run("inspect", filled).stdout == run("inspect", "map", filled).stdout
    with pytest.raises(LogError, match="no such file"):
        run("inspect", "hal.bag")
