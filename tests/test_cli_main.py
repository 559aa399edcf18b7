"""Exit codes and messages of the program as a whole."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT
from robust.trials import try_command, wait_for_tables
from room_drive import drive


def mapmyworld(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cli.main", *(str(a) for a in arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=300
    )


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["build", "--help"], ["config"]])
def test_asking_is_no_error(arguments: list[str]) -> None:
    found = mapmyworld(*arguments)
    assert (found.returncode, found.stderr) == (0, "")
    assert found.stdout


@pytest.mark.parametrize("arguments", [["build"], ["fly"], ["export", "grid", "--mode", "pink"]])
def test_wrong_usage_is_one(arguments: list[str]) -> None:
    found = mapmyworld(*arguments)
    assert found.returncode == 1
    assert "Usage:" in found.stderr
    assert "Traceback" not in found.stderr


def test_bad_input_is_two_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "notes.bag").write_text("not a bag")
    found = mapmyworld("build", tmp_path / "notes.bag")
    assert found.returncode == 2
    assert found.stderr.startswith("mapmyworld: ")
    assert len(found.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_interrupting_leaves_a_map_that_can_be_looked_at(tmp_path: Path) -> None:
    drive(3000).write(tmp_path / "long.mcap")
    command = [sys.executable, "-m", "cli.main", "build", str(tmp_path / "long.mcap")]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "map.db")],
        stderr=subprocess.PIPE,
        text=True,
        # What a script starts in the background has Ctrl-C ignored, its children too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_for_tables(tmp_path / "map.db", process)
    process.send_signal(signal.SIGINT)
    _, reported = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in reported
    found = mapmyworld("inspect", "map", tmp_path / "map.db")  # sound, of a build that had no node
    assert found.returncode == 2
    assert "did not get that far" in found.stderr


def test_a_part_that_does_not_load_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where memory is short, or a library of the system is missing."""
    monkeypatch.setitem(sys.modules, "cli.export", None)
    found = try_command(["export", "grid", "map.db"])
    assert (found.exit_code, found.fault) == (2, "")
    assert "mapmyworld doctor" in found.stderr
    assert len(found.stderr.splitlines()) == 1
