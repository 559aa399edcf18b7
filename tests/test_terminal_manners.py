"""What a person sees while waiting, and at the press of the tab key."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from database_samples import fill

from cli.main import COMMANDS, group
from cli.progress import StderrProgress
from formats.database import open_store

HERE = Path(sys.executable).parent


def test_bash_completes_commands_and_options() -> None:
    def asked(words: str, count: int) -> set[str]:
        environment = os.environ | {
            "COMP_WORDS": words,
            "COMP_CWORD": str(count),
            "_MAPMYWORLD_COMPLETE": "bash_complete",
        }
        command = [sys.executable, "-m", "cli.main"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        return {line.partition(",")[2] for line in done.stdout.splitlines()}

    assert asked("mapmyworld ex", 1) == {"export"}
    assert {"--with-log"} <= asked("mapmyworld export mcap --", 3)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_each_shell_names_the_program(shell: str) -> None:
    result = CliRunner().invoke(group, ["completion", shell])
    assert result.exit_code == 0
    assert "_MAPMYWORLD_COMPLETE" in result.stdout


def test_a_line_of_progress_tells_the_time_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = StderrProgress()
    progress.stage("track", 60.0, "s")
    now[0] += 20.0
    progress.update(15.0)
    progress.finish()
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("track: 25%")
    assert first.endswith("60 s left")
    assert last.startswith("track: 20.0 s")
    (cost,) = progress.costs
    assert (cost.name, cost.wall_s) == ("track", 20.0)
    assert cost.peak_memory_mb > 10


def test_no_colours_where_there_is_no_terminal(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    command = [sys.executable, "-m", "cli.main", "check", str(tmp_path / "map.db")]
    done = subprocess.run(
        [*command, "--require", "nodes >= 1"], capture_output=True, text=True, check=False
    )
    assert "ok " in done.stdout
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_fits_the_terminal(name: str) -> None:
    result = CliRunner().invoke(group, [name, "--help"], terminal_width=80)
    assert result.exit_code == 0
    assert max(map(len, result.output.splitlines())) <= 100
