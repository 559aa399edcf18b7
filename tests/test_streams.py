"""Closed, full and broken standard streams: a build goes on without its words."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from robust import corpus

_PROGRAM = f"{sys.executable} -m cli.main"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    whole = corpus.make_logs(tmp_path_factory.mktemp("logs"))
    lines = next(path for path in whole if path.name == "a.log").read_text().splitlines()
    path = tmp_path_factory.mktemp("short") / "short.log"
    path.write_text("\n".join(lines[:20]) + "\n")
    return path


def shell(line: str, **places: Path) -> subprocess.CompletedProcess[str]:
    """A line of bash in which MAPMYWORLD is the program and names stand for places."""
    line = line.replace("MAPMYWORLD", _PROGRAM)
    for name, place in places.items():
        line = line.replace(name, str(place))
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "streams",
    ["2>&-", "<&- >&- 2>&-", "2>/dev/full", "2>&1 | true", "| true"],
)
def test_a_build_goes_on_without_its_words(log: Path, tmp_path: Path, streams: str) -> None:
    build = "MAPMYWORLD build LOG -o OUT"
    done = shell(f"{build} {streams}; exit ${{PIPESTATUS[0]}}", LOG=log, OUT=tmp_path / "map.db")
    assert done.returncode == 0, done.stderr
    known = shell(f"{build} -q", LOG=log, OUT=tmp_path / "known.db")
    assert known.returncode == 0, known.stderr
    assert (tmp_path / "map.db").read_bytes() == (tmp_path / "known.db").read_bytes()


def test_an_answer_that_cannot_be_written_is_reported_in_one_line(log: Path) -> None:
    done = shell("MAPMYWORLD inspect log LOG > /dev/full", LOG=log)
    assert done.returncode == 2
    assert done.stderr.startswith("mapmyworld: No space left on device")
    assert len(done.stderr.splitlines()) == 1


def test_a_reader_who_has_seen_enough_changes_no_exit_code(log: Path, tmp_path: Path) -> None:
    done = shell("MAPMYWORLD inspect log LOG | true; exit ${PIPESTATUS[0]}", LOG=log)
    assert (done.returncode, done.stderr) == (0, "")
    cut = tmp_path / "cut.log"
    cut.write_text(log.read_text()[:-40])
    done = shell("MAPMYWORLD inspect log LOG | true; exit ${PIPESTATUS[0]}", LOG=cut)
    assert done.returncode == 3
