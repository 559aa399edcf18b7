"""Several logs given as one: those of one session are read together, others are refused."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from room_drive import START_NS, STEP_NS, Drive, Entry, drive, write

from cli.main import group
from formats.logs import open_log
from formats.logs.opening_logs import logs_in
from mapmyworld.errors import ConfigError, LogError
from mapmyworld.types import TransformsMessage

ROOM = drive(40)
SPAN_NS = 40 * STEP_NS
HOUR_NS = 3600 * 10**9


def later(made: Drive, shift_ns: int) -> list[Entry]:
    return [
        (topic, replace(message, stamp_ns=message.stamp_ns + shift_ns), at + shift_ns)  # type: ignore[type-var]
        if not isinstance(message, TransformsMessage)
        else (topic, message, at + shift_ns)
        for topic, message, at in made.entries
    ]


def written(folder: Path, **logs: list[Entry]) -> list[Path]:
    for name, entries in logs.items():
        write(folder / f"{name}.mcap", entries)
    return [folder / f"{name}.mcap" for name in logs]


@pytest.mark.parametrize(
    ("shift_ns", "why"),
    [
        (0, "both record /odom for 4 s at the same time"),
        (SPAN_NS // 2, "at the same time"),
        (2 * HOUR_NS, "2.0 hours lie between them"),
        (5 * 366 * 24 * HOUR_NS, "5 years lie between them"),
    ],
)
def test_drives_of_their_own_are_refused_in_one_line(
    tmp_path: Path, shift_ns: int, why: str
) -> None:
    paths = written(tmp_path, one=list(ROOM.entries), two=later(ROOM, shift_ns))
    for given in (paths, [tmp_path]):
        with pytest.raises(LogError, match=why) as refused:
            open_log(given)
        assert "\n" not in str(refused.value)
        for way in ("batch", "--append", "merge"):
            assert way in str(refused.value)
    assert isinstance(CliRunner().invoke(group, ["build", str(tmp_path)]).exception, LogError)


def test_another_robot_is_refused(tmp_path: Path) -> None:
    other = [(f"/r2{topic}", m, at) for topic, m, at in later(ROOM, SPAN_NS + 10**9)]
    with pytest.raises(LogError, match="no sensor's topic in common"):
        open_log(written(tmp_path, one=list(ROOM.entries), two=other))


def test_parts_of_one_session_are_one_log(tmp_path: Path) -> None:
    """A split recording, whose parts touch; and bags recorded side by side, each of its topics."""
    half = START_NS + SPAN_NS // 2
    first = [e for e in ROOM.entries if e[2] <= half + STEP_NS]
    second = [e for e in ROOM.entries if e[2] > half - STEP_NS]
    assert open_log(written(tmp_path, a=first, b=second)).info().duration_s > 3.8
    sides = [[e for e in ROOM.entries if (e[0] == "/scan") == is_scan] for is_scan in (True, False)]
    assert open_log(written(tmp_path, c=sides[0], d=sides[1])).info().duration_s > 3.8


def test_a_folder_of_logs_is_looked_through(tmp_path: Path) -> None:
    names = ["b.bag", "a_0.mcap", "a_1.mcap", "run_3.bag", "c.clf", "notes.log", "map.db", "x.tum"]
    for name in names:
        (tmp_path / name).write_text("FLASER 1 1 0 0 0 0 0 0 1 h 1\n" if name == "c.clf" else "no")
    (tmp_path / "tum").mkdir()
    (tmp_path / "tum" / "rgb.txt").write_text("")
    found = [tuple(path.name for path in log) for log in logs_in(tmp_path)]
    assert sorted(found) == [
        ("a_0.mcap", "a_1.mcap"), ("b.bag",), ("c.clf",), ("run_3.bag",), ("tum",)
    ]  # fmt: skip
    assert logs_in(tmp_path / "tum") == [(tmp_path / "tum",)]


def test_a_folder_of_parts_of_a_text_log_is_one_log(tmp_path: Path) -> None:
    for name, stamp in (("a_0.clf", 1), ("a_1.clf.gz", 2), ("a_2.clf", 3)):
        line = f"FLASER 1 1 0 0 0 0 0 0 {stamp} h {stamp}\n".encode()
        (tmp_path / name).write_bytes(gzip.compress(line) if name.endswith("gz") else line)
    (tmp_path / "notes.log").write_text("driven on a Monday\n")
    scans = [m.stamp_ns for m in open_log([tmp_path]).messages(["/scan"])]
    assert scans == [10**9, 2 * 10**9, 3 * 10**9]


@pytest.mark.slow
def test_batch_of_a_folder_makes_a_map_of_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").mkdir()
    written(tmp_path / "logs", **{"one": list(ROOM.entries), "two two": later(ROOM, 0)})
    done = CliRunner().invoke(group, ["batch", "logs", "--format", "json", "-q"])
    assert done.exit_code == 0, done.output
    assert [log["name"] for log in json.loads(done.stdout)["logs"]] == ["one", "two_two"]
    assert (tmp_path / "batch" / "two_two" / "map.db").exists()


def test_batch_of_a_folder_without_logs_says_so(tmp_path: Path) -> None:
    found = CliRunner().invoke(group, ["batch", str(tmp_path)])
    assert isinstance(found.exception, ConfigError)
    assert "no log in this folder" in str(found.exception)
