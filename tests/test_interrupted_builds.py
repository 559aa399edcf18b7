"""Builds that somebody or something stops: the map keeps what is finished, and goes on the same."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from robust import corpus, kills, signals
from robust.trials import Outcome, try_command

from cli.interrupts import Interrupted, forget_interrupts, heed_interrupts, heed_wish
from mapmyworld import pipeline


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = corpus.make_logs(tmp_path_factory.mktemp("logs"))
    return {path.name: path for path in made}


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--method", "fastslam")])
def test_control_c_at_any_moment_leaves_a_map_that_goes_on(
    logs: dict[str, Path], options: tuple[str, ...]
) -> None:
    found = kills.kill_builds(logs["a.log"], options, 4, 1, lambda _: None, signal.SIGINT)
    assert found.faults == []
    assert found.kills == 4


@pytest.mark.slow
def test_commands_that_are_ended_at_random_moments_end_soon_and_in_order(
    logs: dict[str, Path], tmp_path: Path
) -> None:
    """By Ctrl-C and by --max-memory, in their own processes; the benchmark tries all commands."""
    place = signals.make_place(logs["whole.mcap"], tmp_path)
    for name, how in (("build", signal.SIGINT), ("build", None), ("convert", signal.SIGINT)):
        found = signals.end_commands(place, name, how, 2, seed=2)
        assert found.faults == []
        assert found.trials == 2


@pytest.mark.parametrize("name", ["plain.mcap", "whole.bag", "plain.db3", "a.log", "a.clf.bz2"])
@pytest.mark.parametrize("fate", ["removed", "cut", "replaced"])
def test_a_log_that_vanishes_during_a_build(
    logs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, fate: str
) -> None:
    """It is there when the plan is made and gone, or another, when it is to be followed."""
    log, path = tmp_path / name, tmp_path / "map.db"
    log.write_bytes(logs[name].read_bytes())
    follow = pipeline.track

    def late(*arguments: object, **named: object) -> object:
        if fate == "removed":
            log.unlink()
        else:
            data = logs[name].read_bytes()
            log.write_bytes(data[: len(data) // 2] if fate == "cut" else data[::-1])
        return follow(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "track", late)
    command = ["build", str(log), "-o", str(path), "-q", "--no-export"]
    stopped = try_command(command)
    assert stopped.fault == ""
    assert stopped.exit_code == 2
    assert len(stopped.stderr.strip().splitlines()) == 1
    assert name in stopped.stderr
    assert kills.finished_stages(path) in ([], ["plan"])
    monkeypatch.undo()
    log.write_bytes(logs[name].read_bytes())
    assert try_command(command).exit_code in (0, 3)
    whole = tmp_path / "whole.db"
    assert try_command([*command[:3], str(whole), *command[4:]]).exit_code in (0, 3)
    assert path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("name", ["plain.mcap", "whole.bag", "a.log"])
def test_a_log_that_is_still_being_copied_is_taken_when_it_is_whole(
    logs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    log, whole = tmp_path / name, logs[name].read_bytes()
    log.write_bytes(whole[: len(whole) * 2 // 3])
    follow = pipeline.track

    def late(*arguments: object, **named: object) -> object:
        log.write_bytes(whole)
        return follow(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "track", late)
    build = ["build", str(log), "-q", "--no-export", "-o"]
    assert try_command([*build, str(tmp_path / "map.db")]).exit_code == 2
    monkeypatch.undo()
    assert try_command([*build, str(tmp_path / "map.db")]).exit_code == 0
    assert try_command([*build, str(tmp_path / "known.db")]).exit_code == 0
    assert (tmp_path / "map.db").read_bytes() == (tmp_path / "known.db").read_bytes()


_LONG_HASH = """
import os
import time
from formats.logs.carmen import CarmenLog
def content_hash(log):
    os.write(1, b"reading\\n")  # a lock of stdout held by a daemon thread aborts at exit
    time.sleep(300.0)
CarmenLog.content_hash = content_hash
from cli.main import main
main()
"""


def test_control_c_does_not_wait_for_the_hash_of_a_long_log(
    logs: dict[str, Path], tmp_path: Path
) -> None:
    command = [sys.executable, "-c", _LONG_HASH, "build", str(logs["a.log"]), "-q"]
    with subprocess.Popen(
        [*command, "-o", str(tmp_path / "map.db")], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as build:
        assert build.stdout is not None
        assert build.stdout.readline() == b"reading\n"
        build.send_signal(signal.SIGINT)
        _, stderr = build.communicate(timeout=90)
    assert build.returncode == 130
    assert len(stderr.strip().splitlines()) == 1


def test_a_read_only_folder_is_one_line(logs: dict[str, Path]) -> None:
    with tempfile.TemporaryDirectory(prefix="read-only-") as name:  # pytest's own is nobody else's
        place = Path(name)
        folder, log = place / "folder", place / "a.log"
        shutil.copyfile(logs["a.log"], log)
        folder.mkdir()
        loaded = try_command(["build", str(log), "-o", str(place / "other.db"), "-q"])
        assert loaded.exit_code == 0  # and all is imported that only the superuser may read
        for path, mode in ((place, 0o755), (log, 0o644), (folder, 0o555)):
            path.chmod(mode)
        found = unprivileged(["build", str(log), "-o", str(folder / "map.db"), "-q"])
        assert list(folder.iterdir()) == []
        folder.chmod(0o755)
    assert found.fault == ""
    assert found.exit_code == 2
    assert len(found.stderr.strip().splitlines()) == 1
    assert "folder" in found.stderr


def unprivileged(arguments: list[str]) -> Outcome:
    """The command in a child that is not the superuser, who may write everywhere."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            if os.geteuid() == 0:
                os.setuid(65534)
            outcome = try_command(arguments)
            reported = f"{outcome.exit_code}\n{outcome.fault}\0{outcome.stderr}"
            os.write(writing, reported.encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        code, _, rest = stream.read().partition("\n")
    os.waitpid(child, 0)
    fault, _, stderr = rest.partition("\0")
    return Outcome(int(code) if code.isdigit() else None, fault, "", stderr)


@contextmanager
def ending() -> Iterator[None]:
    """Ctrl-C raises `Interrupted`, as in a command."""
    before = signal.getsignal(signal.SIGINT)
    heed_interrupts()
    try:
        yield
    finally:
        forget_interrupts()
        signal.signal(signal.SIGINT, before)


def test_a_signal_waits_until_progress_is_reported() -> None:
    """In the import machinery, say, it would leave a lock held, and threads waiting for ever."""
    with ending():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Interrupted):
            heed_wish()
        with pytest.raises(Interrupted):  # others' code may have lost the first
            heed_wish()
        forget_interrupts()
        heed_wish()


def test_a_signal_while_an_object_is_cleared_away_prints_nothing_and_is_raised_again(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python drops what a destructor raises, and printed a traceback of it."""

    class Cleared:
        def __init__(self, error: BaseException) -> None:
            self.error = error

        def __del__(self) -> None:
            raise self.error

    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    with ending():
        signal.raise_signal(signal.SIGINT)
        Cleared(Interrupted())
        assert capfd.readouterr().err == ""
        Cleared(ValueError("another fault"))
        assert "another fault" in capfd.readouterr().err
        with pytest.raises(Interrupted):
            heed_wish()
    assert sys.unraisablehook is sys.__unraisablehook__


def test_work_that_reports_nothing_is_ended_after_a_while() -> None:
    began = time.monotonic()
    with ending():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Interrupted):
            threading.Event().wait(60.0)
    assert 1.0 <= time.monotonic() - began < 30.0


_STUCK = """
import sys, threading, time
from cli import interrupts
interrupts._CLEARS_UP_WITHIN_S = 0.1
interrupts.heed_interrupts()
print("works", flush=True)
try:
    time.sleep(300.0)
finally:
    print("clears up", flush=True)
    while True:
        try:
            threading.Lock().acquire() and time.sleep(300.0)
        except BaseException:
            print("was struck again", flush=True)
"""


def test_what_does_not_end_is_ended_without_order() -> None:
    """As where a lock was left held: a map survives that as it survives a kill."""
    with stuck(_STUCK) as process:
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stdout) == (130, b"clears up\n")
    assert len(stderr.splitlines()) == 1


def test_the_third_control_c_ends_at_once() -> None:
    with stuck(_STUCK.replace("0.1", "300.0")) as process:
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        assert process.stdout.readline() == b"clears up\n"
        while process.poll() is None:  # two at the same moment would be one
            process.send_signal(signal.SIGINT)
            time.sleep(0.05)
    assert process.returncode == -signal.SIGINT


@contextmanager
def stuck(script: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-c", script]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"works\n"
            yield process
        finally:
            process.kill()
