"""`--debug FILE`: what was decided, and when."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from room_drive import drive

from cli.main import group
from mapmyworld.decisions import is_heard


def run(*words: object) -> Result:
    return CliRunner().invoke(group, [str(word) for word in words])


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Of a build of 60 scans in a room."""
    folder = tmp_path_factory.mktemp("debug")
    drive(60).write(folder / "room.mcap")
    result = run(
        "build", folder / "room.mcap", "-o", folder / "room.db", "-q", "--debug", folder / "log"
    )
    assert result.exit_code in {0, 3}, result.output
    assert "track" not in result.stderr  # nothing of it is printed
    return (folder / "log").read_text().splitlines()


def of(lines: list[str], topic: str) -> list[str]:
    return [line.split(None, 3)[3] for line in lines if line.split()[2] == topic]


def test_every_decision_of_a_build_is_a_line(lines: list[str]) -> None:
    assert all(re.match(r" *\d+ ms  \w+ +\S", line) for line in lines)
    times = [float(line.split()[0]) for line in lines]
    assert times == sorted(times)
    assert any(text.startswith("scan: ") for text in of(lines, "plan"))
    assert len(of(lines, "track")) == 60
    assert of(lines, "track")[0].endswith("becomes node 1")
    assert "scan matching: matched, overlap" in of(lines, "track")[-1]
    closures = [text for text in of(lines, "verdict") if text.startswith("loop_closure")]
    assert len(of(lines, "closure")) >= len(closures)
    assert all(re.search("(accepted|rejected): .", text) for text in of(lines, "closure"))
    assert any("nodes solved" in text for text in of(lines, "graph"))
    assert any("cells of 0.05 m" in text for text in of(lines, "map"))
    stages = of(lines, "stage")
    assert any(text.startswith("track: inputs") for text in stages)
    assert any(re.match(r"track took [\d.]+ s", text) for text in stages)


def test_a_stage_that_is_passed_over_says_so(tmp_path: Path) -> None:
    drive(20).write(tmp_path / "room.mcap")
    words = ("build", tmp_path / "room.mcap", "-o", tmp_path / "room.db", "--no-export")
    run(*words)
    run(*words, "--debug", tmp_path / "log")
    assert "track: done before with the same inputs" in of(
        (tmp_path / "log").read_text().splitlines(), "stage"
    )
    assert not is_heard()  # the next command is not listened to


def test_an_error_is_there_with_where_it_was_raised(tmp_path: Path) -> None:
    result = run("build", tmp_path / "none.bag", "--debug", tmp_path / "log")
    assert result.exit_code != 0
    text = (tmp_path / "log").read_text()
    assert "none.bag" in text
    assert "Traceback" in text


def test_only_an_earlier_log_of_decisions_is_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "drive.bag"
    precious.write_bytes(b"#ROSBAG V2.0")
    result = run("inspect", "log", precious, "--debug", precious)
    assert "is no log of --debug" in str(result.exception)
    assert precious.read_bytes() == b"#ROSBAG V2.0"
    for _ in range(2):
        run("config", "--debug", tmp_path / "log")
    assert (tmp_path / "log").read_text().count(" command ") == 3
