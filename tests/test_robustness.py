"""Short versions of benchmarks/robustness.py: hostile files, kills, full disks, second builders."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from robust import corpus, full_disk, fuzzing, kills
from robust.trials import try_command
from robustness import GRAPH_COMMANDS, INSPECT

from formats.database import open_store
from formats.database.lock import only_writer
from formats.whole_files import write_whole
from mapmyworld.errors import MapError


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return corpus.make_logs(tmp_path_factory.mktemp("logs"))


def faults(sources: list[Path], commands: list[tuple[str, ...]], count: int) -> list[str]:
    found = []
    for case in fuzzing.cases(sources, commands, count, seed=7):
        _, fault, _, _ = fuzzing.run_case(case)
        found += [f"{case}: {fault}"] if fault else []
    return found


def test_hostile_logs_of_every_kind_end_in_one_line(logs: list[Path]) -> None:
    quick = (*INSPECT, "--quick")
    assert faults(logs, [quick, ("convert", "FILE", "-o", "OUT.mcap")], 150) == []


def test_hostile_graphs_and_grids_end_in_one_line(tmp_path: Path) -> None:
    assert faults(corpus.make_graphs(tmp_path / "graphs"), GRAPH_COMMANDS, 60) == []
    grids = corpus.make_grids(tmp_path / "grids")
    truth = str(grids[0] / "map.yaml")
    assert faults(grids, [("evaluate", "grid", "FILE", truth)], 30) == []


def test_a_closure_longer_than_any_map_is_rejected_and_stops_nothing(tmp_path: Path) -> None:
    """Found by the campaign: beside its length, covariances are singular by rounding."""
    flat = corpus.make_graphs(tmp_path / "graphs")[0]
    lines = flat.read_text().replace("EDGE_SE2 2 11 0.25", "EDGE_SE2 2 11 99999999999999999999")
    flat.write_text("".join(line for line in lines.splitlines(True) if "SE2 9 -" not in line))
    found = try_command(["optimise", str(flat), "--robust", "-o", str(tmp_path / "out.g2o")])
    assert found.fault == ""
    assert found.exit_code == 3  # a node without a vertex
    assert "2-11" in found.stdout


@pytest.mark.slow
def test_hostile_maps_end_in_one_line(logs: list[Path], tmp_path: Path) -> None:
    maps = corpus.make_maps(tmp_path, logs[0])
    commands = [
        ("inspect", "map", "FILE"), ("inspect", "graph", "FILE"), ("inspect", "node", "FILE", "2"),
        ("export", "trajectory", "FILE", "-o", "OUT.tum"), ("export", "grid", "FILE", "-o", "OUT"),
    ]  # fmt: skip
    assert faults(maps, commands, 100) == []


@pytest.mark.slow
def test_killed_builds_end_in_the_same_bytes_and_repeat_no_finished_stage(
    logs: list[Path],
) -> None:
    by_name = {path.name: path for path in logs}
    for name, options in (("a.log", ()), ("a.log", ("--method", "fastslam"))):
        found = kills.kill_builds(by_name[name], options, 4, seed=3, watch=lambda _: None)
        assert found.faults == []
        assert found.kills == 4


@pytest.mark.slow
def test_a_disk_that_fills_tears_no_map(logs: list[Path]) -> None:
    if full_disk.compiler() is None:
        pytest.skip("no C compiler: the faulty disk cannot be made")
    log = next(path for path in logs if path.name == "lz4.mcap")
    assert full_disk.fill_disks(log, ("--no-export",), 8).faults == []


def test_a_second_build_on_one_map_is_refused(logs: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    with only_writer(path):
        found = try_command(["build", str(logs[1]), "-o", str(path), "-q"])
    assert found.exit_code == 2
    assert "another mapmyworld is writing this map" in found.stderr
    assert not path.exists()
    with only_writer(path):  # freed
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_second_build_through_a_link_is_refused_too(logs: list[Path], tmp_path: Path) -> None:
    link, path = tmp_path / "link.db", tmp_path / "real" / "map.db"
    path.parent.mkdir()
    link.symlink_to(path)
    for held, asked in ((path, link), (link, path)):
        with only_writer(held):
            found = try_command(["build", str(logs[1]), "-o", str(asked), "-q"])
        assert found.exit_code == 2
        assert "another mapmyworld is writing this map" in found.stderr
    assert not path.exists()


def test_a_disk_without_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", none)
    with pytest.raises(MapError, match="keeps no locks"), only_writer(tmp_path / "map.db"):
        pass


def test_a_map_that_is_moved_while_it_is_written_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    with open_store(path, create=True) as store:
        store.put("one", 1)
        path.rename(tmp_path / "other.db")
        with pytest.raises(MapError, match="was moved or removed while it was written"):
            store.put("two", 2)


def test_a_folder_that_cannot_be_written_is_one_line(logs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    found = try_command(["build", str(logs[1]), "-o", str(tmp_path / "file" / "map.db"), "-q"])
    assert found.exit_code == 2
    assert len(found.stderr.strip().splitlines()) == 1


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "grid.pgm"
    write_whole(path, b"old")
    with pytest.raises(MapError, match="folder"):
        write_whole(tmp_path / "absent" / "grid.pgm", b"new")
    (tmp_path / "there").mkdir()
    with pytest.raises(MapError, match="is a folder"):
        write_whole(tmp_path / "there", b"new")
    assert path.read_bytes() == b"old"
    write_whole(path, "new")
    assert path.read_bytes() == b"new"
    assert {p.name for p in tmp_path.iterdir()} == {"grid.pgm", "there"}


@pytest.mark.slow
def test_a_second_build_elsewhere_gives_the_same_bytes(logs: list[Path], tmp_path: Path) -> None:
    """Another folder, time zone, locale and number of threads."""
    path = tmp_path / "map.db"
    options = ["-o", str(path), "--verify-repeat", "-q", "--set", "threads=2"]
    assert try_command(["build", str(logs[0]), *options], seconds=120.0).exit_code == 0
    assert not list(tmp_path.glob(".repeat-*"))


def test_more_memory_than_allowed_ends_in_order(logs: list[Path], tmp_path: Path) -> None:
    command = ["build", str(logs[1]), "-o", str(tmp_path / "map.db"), "-q", "--max-memory", "20"]
    found = subprocess.run(
        [sys.executable, "-m", "cli.main", *command],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert found.returncode == 2
    assert "--max-memory" in found.stderr
    assert len(found.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "map.db.lock").exists()


def test_every_cut_gives_what_precedes_it(logs: list[Path], tmp_path: Path) -> None:
    """At twelve places of each container; the benchmark takes two hundred."""
    from robust.cuts import cut_everywhere

    chosen = [path for path in logs if path.name in {"bare.mcap", "plain.mcap", "whole.bag"}]
    for path, kind in product(chosen, ("cut", "flip")):
        found = cut_everywhere(path, tmp_path / f"cut{path.suffix}", 12, kind)
        assert found.faults == []
        assert found.tried >= 12
