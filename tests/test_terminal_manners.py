"""What a person sees while waiting, and at the press of the tab key."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading
from contextlib import suppress
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from database_samples import fill
from room_drive import drive

from cli.interrupts import Interrupted
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
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=300
        )
        return {line.partition(",")[2] for line in done.stdout.splitlines()}

    assert asked("mapmyworld ex", 1) == {"export"}
    assert {"--with-log"} <= asked("mapmyworld export mcap --", 3)
    assert asked("mapmyworld build x.bag --set mapping.res", 4) == {"mapping.resolution="}
    assert asked("mapmyworld check --require 'loop_c", 3) == {"loop_closures"}
    assert asked("mapmyworld check none.db --require map.", 4) == {""}


def test_bash_puts_no_space_behind_half_of_a_setting(tmp_path: Path) -> None:
    """The script, sourced by bash, with a program that answers as ours does."""
    script = CliRunner().invoke(group, ["completion", "bash"]).stdout
    (tmp_path / "script").write_text(script)
    answers = 'compopt() { echo "asked: $1 $2"; }; complete() { :; }; '
    for answer, asked in (("mapping.resolution=", "asked: -o nospace"), ("--set", "")):
        ask = f"env() {{ echo plain,{answer}; }}; _mapmyworld_completion mapmyworld; "
        reported = subprocess.run(
            ["bash", "-c", f"{answers} source ./script; {ask} echo \"${{COMPREPLY[0]}}\""],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        assert reported.split("\n")[:-1] == [*([asked] if asked else []), answer]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_each_shell_names_the_program(shell: str) -> None:
    result = CliRunner().invoke(group, ["completion", shell])
    assert result.exit_code == 0
    assert "_MAPMYWORLD_COMPLETE" in result.stdout


def test_a_line_of_progress_indicates_the_time_left(
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
    assert last.startswith("track:  20.0 s")
    (cost,) = progress.costs.values()
    assert (cost.name, cost.wall_s) == ("track", 20.0)
    assert cost.peak_memory_mb > 10


def test_a_slow_stage_has_a_rate_as_well(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sessions joined in 53 s went at "0 sessions/s", and a slow log at "0x real time"."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = StderrProgress()
    for unit, speed in (("sessions", "(0.038 sessions/s)"), ("s", "(0.038x real time)")):
        progress.stage("join sessions", 2, unit)
        now[0] += 53.0
        progress.update(2)
        progress.finish()
        assert capsys.readouterr().err.rstrip().endswith(speed)


def test_rounds_of_a_stage_are_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line "loop closures by laser: 0.0 s" came up to fifteen times."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = StderrProgress()
    for _ in range(3):
        for name, took in (("loop closures by laser", 2.0), ("optimise", 0.5)):
            progress.stage(name, 10, "pairs")
            now[0] += took
            progress.update(10)
    progress.end()
    assert capsys.readouterr().err == ""
    progress.finish()
    assert capsys.readouterr().err.splitlines() == [
        "loop closures by laser:  6.0 s  in 3 rounds (5 pairs/s)",
        "optimise:                1.5 s  in 3 rounds (20 pairs/s)",
    ]
    assert [(c.name, c.wall_s, c.rounds) for c in progress.costs.values()] == [
        ("loop closures by laser", 6.0, 3),
        ("optimise", 1.5, 3),
    ]


def test_verbose_stages_have_time_and_memory(tmp_path: Path) -> None:
    drive(20).write(tmp_path / "room.mcap")
    result = CliRunner().invoke(
        group, ["build", str(tmp_path / "room.mcap"), "-o", str(tmp_path / "room.db"), "-v"]
    )
    lines = result.stderr.splitlines()
    (track,) = (line for line in lines if line.startswith("track:"))
    assert re.match(r"track: +[\d.]+ s +[\d.]+ CPU s +\d+ MB", track)
    assert lines[-1].startswith("mapmyworld build: ") or "at most" in lines[-1]


def test_stages_that_ended_are_reported_though_the_command_fails(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with suppress(Interrupted), click.Context(click.Command("build")):
        progress = StderrProgress()
        progress.stage("survey")
        progress.stage("track")
        raise Interrupted
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("survey:")


def test_what_an_interrupted_command_says_has_a_line_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm-256color")
    with suppress(Interrupted), click.Context(click.Command("build")):
        StderrProgress().stage("track", 60.0, "s")
        raise Interrupted
    assert "track" in terminal.getvalue()
    erased = terminal.getvalue().rpartition("track")[2]
    assert "\x1b[2K" in erased  # the bar's line
    assert "\x1b[?25h" in erased  # and the cursor is there again


def test_no_colours_where_there_is_no_terminal(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    command = [sys.executable, "-m", "cli.main", "check", str(tmp_path / "map.db")]
    done = subprocess.run(
        [*command, "--require", "nodes >= 1"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert "ok " in done.stdout
    assert "\x1b" not in done.stdout + done.stderr


def at_a_terminal(words: list[str], folder: Path) -> str:
    """What a command shows on a terminal of 80 x 24."""
    shown, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    command = [sys.executable, "-m", "cli.main", *words]
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    with subprocess.Popen(
        command, cwd=folder, stdin=terminal, stdout=terminal, stderr=terminal, env=environment
    ) as process:
        os.close(terminal)
        late = threading.Timer(300.0, process.kill)
        late.start()
        parts = []
        while True:
            try:
                parts.append(os.read(shown, 65536))
            except OSError:  # how Linux indicates that the other end is closed
                break
            if not parts[-1]:
                break
        late.cancel()
    os.close(shown)
    assert process.returncode == 0, b"".join(parts).decode()
    return b"".join(parts).decode()


@pytest.mark.slow
def test_a_build_at_a_terminal_ends_with_one_screen(tmp_path: Path) -> None:
    """A bar with the time left while it works, taken away when done; then words, no colours."""
    drive(60).write(tmp_path / "room.mcap")
    shown = at_a_terminal(["build", "room.mcap", "-o", "room.db"], tmp_path)
    assert "\x1b[?25l" in shown  # the bar hides the cursor,
    assert "\x1b[?25h" in shown  # and gives it back
    assert re.search(r"track .*\d+% .*, \d+ s left", shown)
    done = shown.rpartition("\x1b[?25h")[2]
    summary = done[done.index("nodes: ") :]
    assert len(summary.splitlines()) < 24
    assert max(len(line) for line in summary.splitlines()) <= 80
    assert "\x1b[3" not in summary
    stages = re.findall(r"^([\w ]+): +[\d.]+ s", done, re.MULTILINE)
    assert "track" in stages
    assert len(stages) == len(set(stages)) <= 9  # each once, however many rounds it took


def test_colours_at_a_terminal(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    shown = at_a_terminal(["check", "map.db", "--require", "nodes >= 1"], tmp_path)
    assert "\x1b[32mok" in shown


def test_no_code_follows_the_last_word_of_a_carmen_log(tmp_path: Path) -> None:
    """numba, loaded for the log's numbers, had colorama end the program with a literal \\x1b[0m."""
    sweep = f"FLASER 180 {' '.join(['2.5'] * 180)} 0 0 0 0 0 0"
    lines = [f"{sweep} {k / 10:.6f} host {k / 10:.6f}\n" for k in range(20)]
    (tmp_path / "drive.log").write_text("".join(lines))
    shown = at_a_terminal(["inspect", "log", "drive.log", "--quick"], tmp_path)
    assert "\\x1b" not in shown
    assert "\x1b" not in shown


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_fits_the_terminal(name: str) -> None:
    result = CliRunner().invoke(group, [name, "--help"], terminal_width=80)
    assert result.exit_code == 0
    assert max(map(len, result.output.splitlines())) <= 100
    assert all(sign.isprintable() or sign == "\n" for sign in result.output)
