"""Where commands may write: never over what they read, nor over a log or what is no file."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from conftest import ROOT
from database_samples import fill

from cli.export import export
from cli.main import group
from formats.database import open_store
from mapmyworld.errors import MapMyWorldError

TRIANGLE = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 900 0 0 900 0 900\n" for k in range(3))
_OF_ANOTHER_NAME = {"grid", "images"}  # STEM.pgm and STEM.yaml, and a folder: not FILE itself
EXPORTS = sorted(set(export.commands) - _OF_ANOTHER_NAME)


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("filled") / "map.db"
    with open_store(path, create=True) as store:
        fill(store)
    return path


@pytest.fixture
def m(filled: Path, tmp_path: Path) -> Path:
    shutil.copyfile(filled, tmp_path / "m.db")
    return tmp_path / "m.db"


def given(*words: object) -> Result:
    return CliRunner().invoke(group, [str(word) for word in words])


def refused(*words: object, saying: str = "give") -> None:
    """`main` makes exit code 2 and one line of it."""
    error = given(*words).exception
    assert isinstance(error, MapMyWorldError), error
    assert len(str(error).splitlines()) == 1
    assert saying in str(error)


def by_itself(path: Path) -> Path:
    return path


def by_link(path: Path) -> Path:
    path.with_name("link.db").symlink_to(path)
    return path.with_name("link.db")


def by_hard_link(path: Path) -> Path:
    os.link(path, path.with_name("hard.db"))
    return path.with_name("hard.db")


@pytest.mark.parametrize("named", [by_itself, by_link, by_hard_link])
def test_no_command_writes_over_the_map_it_reads(m: Path, named: Callable[[Path], Path]) -> None:
    before, output = m.read_bytes(), named(m)
    what = EXPORTS if named is by_itself else ["trajectory"]
    for name in what:
        refused("export", name, m, "-o", output, saying="another name")
    refused("optimise", m, "-o", output, saying="another name")
    assert m.read_bytes() == before


def test_what_is_written_beside_a_map_replaces_no_input(m: Path) -> None:
    page = m.rename(m.with_suffix(".html"))
    before = page.read_bytes()
    refused("export", "report", page, saying="another name")
    refused("build", page, "-o", page.with_suffix(".db"), saying="another name")
    refused("build", ROOT / "sample_logs" / "apartment.mcap", "-o", "x.ply", saying=".db")
    assert page.read_bytes() == before


def test_localise_and_convert_spare_what_they_read(m: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(b"\x89MCAP0\r\n")
    os.link(log, tmp_path / "same.mcap")
    refused("localise", m, log, "-o", tmp_path / "same.mcap", saying="another name")
    refused("convert", log, "-o", tmp_path / "same.mcap", "--overwrite", saying="another name")
    refused("check", m, "--require", "nodes >= 1", "--junit", m, saying="another name")
    refused("compare", m, "--image", m, saying="another name")
    refused("inspect", "graph", m, "--image", m, saying="another name")
    assert log.read_bytes() == b"\x89MCAP0\r\n"


def test_merge_and_optimise_replace_only_what_they_write(m: Path, tmp_path: Path) -> None:
    other, bag, graph = tmp_path / "n.db", tmp_path / "p.bag", tmp_path / "x.g2o"
    shutil.copyfile(m, other)
    bag.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    graph.write_text(TRIANGLE)
    before = [path.read_bytes() for path in (m, other, bag, graph)]
    for output in (m, other, bag):
        refused("merge", m, other, "-o", output)
    os.link(other, tmp_path / "week_2.db")
    refused("merge", m, other, "-o", tmp_path / "week.db", saying="week_2.db")
    refused("optimise", graph, "-o", graph)
    assert given("optimise", graph, "-o", bag).exit_code != 0
    refused("export", "trajectory", m, "-o", bag)
    assert [path.read_bytes() for path in (m, other, bag, graph)] == before


@pytest.mark.parametrize("name", ["x.toro", "x.graph", "x"])
def test_optimise_writes_no_graph_of_another_kind(name: str, tmp_path: Path) -> None:
    graph = tmp_path / "given.g2o"
    graph.write_text(TRIANGLE)
    result = given("optimise", graph, "-o", tmp_path / name)
    assert result.exit_code != 0
    assert "ends in .g2o" in result.output
    assert not (tmp_path / name).exists()


def test_optimise_replaces_what_it_made_but_no_map_of_a_log(m: Path, tmp_path: Path) -> None:
    graph, made = tmp_path / "x.g2o", tmp_path / "made"
    graph.write_text(TRIANGLE)
    for ending in (".g2o", ".db"):
        for _ in range(2):
            assert given("optimise", graph, "-o", made.with_suffix(ending)).exit_code == 0
    with open_store(m) as store:
        store.put("log", {"hash": "h", "paths": ["drive.bag"]})
    refused("optimise", graph, "-o", m, saying="drive.bag")
    assert given("optimise", m, "-o", tmp_path / "of_m.db").exit_code in (0, 3)
    assert given("optimise", m, "-o", tmp_path / "of_m.db").exit_code in (0, 3)
    log = ROOT / "sample_logs" / "apartment.mcap"
    refused("build", log, "-o", made.with_suffix(".db"), saying="--overwrite")
    with open_store(made.with_suffix(".db"), read_only=True) as store:
        assert len(store.nodes()) == 4


@pytest.mark.parametrize("place", [".", "", "/", "..", "folder", "/dev/null"])
def test_an_output_that_is_no_file_is_refused_in_a_line(
    m: Path, tmp_path: Path, place: str
) -> None:
    (tmp_path / "folder").mkdir()
    where = tmp_path / place if place == "folder" else place
    log, graph = ROOT / "sample_logs" / "apartment.mcap", tmp_path / "x.g2o"
    graph.write_text(TRIANGLE)
    commands: list[list[object]] = [
        ["build", log],
        ["merge", m, graph],
        ["optimise", graph],
        ["export", "trajectory", m],
    ]
    if place in (".", "", "/"):
        commands += [["export", "grid", m], ["simulate", "hall"], ["convert", log]]
    if place == ".":
        commands.append(["build", log, "--append", "."])
    for command in commands:
        words = command if "--append" in command else [*command, "-o", where]
        refused(*words, saying="device" if place == "/dev/null" else "folder")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_verdicts_may_go_to_a_pipe(m: Path) -> None:
    assert given("check", m, "--require", "nodes >= 1", "--junit", "/dev/null").exit_code == 0
