"""Builds that somebody or something stops: the map keeps what is finished, and goes on the same."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from robust import corpus, kills, signals
from robust.trials import Outcome, try_command

from cli.interrupts import (
    HANDING_OVER,
    ending_with,
    forget_interrupts,
    forget_wish,
    heed_interrupts,
)
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
import time
from formats.logs.carmen import CarmenLog
def content_hash(log):
    print("reading", flush=True)
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


class _Ended(BaseException):
    """What the handler under test raises."""


@contextmanager
def ending() -> Iterator[None]:
    """SIGUSR1 raises `_Ended`, as in a command."""
    heed_interrupts()
    before = signal.signal(signal.SIGUSR1, ending_with(_Ended))
    try:
        yield
    finally:
        forget_wish(_Ended)
        forget_interrupts()
        signal.signal(signal.SIGUSR1, before)


def run_as(module: str, source: str, file: str = "code.py", **names: object) -> None:
    """Runs the source as if it stood in that module."""
    scope = {"raise_signal": signal.raise_signal, "SIGUSR1": signal.SIGUSR1, **names}
    exec(compile(source, file, "exec"), {**scope, "__name__": module})


_ALARM = signal.SIGALRM
_STRUCK = "raise_signal(SIGUSR1)\nleft.append(True)\n"


@pytest.mark.parametrize("module", ["_frozen_importlib", "numba.core.compiler", "queue", "json"])
def test_a_signal_waits_until_code_of_ours_runs(module: str) -> None:
    """In the import machinery, say, it would leave a lock held, and threads waiting for ever."""
    left: list[bool] = []
    with ending():
        run_as(module, _STRUCK, left=left)
        assert left == [True]
        with pytest.raises(_Ended):
            run_as("mapmyworld.pipeline", "while True: sleep(0.01)", sleep=time.sleep)


def test_a_signal_is_heeded_at_once_in_code_of_ours() -> None:
    left: list[bool] = []
    with ending(), pytest.raises(_Ended):
        run_as("formats.logs", _STRUCK, left=left)
    assert left == []


def test_what_is_raised_is_seen_to_before_it_is_raised_again() -> None:
    """An alarm on its way, or a second Ctrl-C, would end in a traceback of the first one's end."""
    left: list[bool] = []
    with ending():
        with pytest.raises(_Ended):
            run_as("formats.logs", _STRUCK, left=left)
        run_as("cli.main", _STRUCK, left=left)
        run_as("cli.main", _STRUCK.replace("SIGUSR1", "SIGALRM"), left=left, SIGALRM=_ALARM)
        forget_wish(_Ended)
        run_as("cli.main", _STRUCK.replace("SIGUSR1", "SIGALRM"), left=left, SIGALRM=_ALARM)
    assert left == [True] * 3


def test_code_of_others_that_does_not_end_is_ended_after_a_while() -> None:
    began = time.monotonic()
    with ending(), pytest.raises(_Ended):
        run_as("shutil", "raise_signal(SIGUSR1)\nwhile True: sleep(0.01)", sleep=time.sleep)
    assert 1.0 <= time.monotonic() - began < 10.0


def test_a_wait_for_other_threads_is_ended_after_a_while() -> None:
    with ending(), pytest.raises(_Ended):
        run_as("cli.batching", "raise_signal(SIGUSR1)", raise_signal=_struck_in(threading.Event()))


def _struck_in(event: threading.Event) -> Callable[[int], object]:
    """A function that waits for the event, and is sent the signal while it does."""

    def wait(number: int) -> object:
        threading.Timer(0.1, signal.pthread_kill, (threading.get_ident(), number)).start()
        return event.wait()

    return wait


_HANDED_OVER = """
import random, signal, faulthandler
from cli import interrupts
from cli.interrupts import ending_with, forget_wish, heed_interrupts
from mapmyworld.parallel import done_behind, in_threads, made_ahead
from mapmyworld.parallel import run_in_chunks
__name__ = "cli.struck"
class Ended(BaseException): pass
def work():
    for number in in_threads(abs, made_ahead(range(3000), 8), 2):
        with done_behind(sums.append, 4) as behind:
            behind(number)
        run_in_chunks(lambda a, b: None, 8, 2)
heed_interrupts()
interrupts._PATIENCE_S = 0.05
signal.signal(signal.SIGPROF, ending_with(Ended))
faulthandler.dump_traceback_later(60, exit=True)
rng, ended = random.Random(3), 0
for _ in range(6):
    sums = []
    signal.setitimer(signal.ITIMER_PROF, rng.uniform(0.001, 0.02))
    try:
        work()
    except Ended:
        ended += 1
    forget_wish(Ended)
print(ended)
"""


def test_signals_leave_no_thread_waiting_in_the_queues_between_threads() -> None:
    """Before, the first or second left a queue's lock held, and the other thread waited for it."""
    done = subprocess.run(
        [sys.executable, "-c", _HANDED_OVER], capture_output=True, text=True, timeout=90, check=True
    )
    assert done.stderr == ""
    assert int(done.stdout) >= 3


def test_all_that_hands_work_from_thread_to_thread_is_known() -> None:
    """A new pool or queue in the library belongs on the list, or where signals never strike."""
    root = Path(pipeline.__file__).parent
    users = {
        "mapmyworld." + ".".join(file.relative_to(root).with_suffix("").parts)
        for file in root.rglob("*.py")
        if re.search(r"ThreadPoolExecutor\(|threading\.Thread\(", file.read_text("utf-8"))
    }
    assert users == {
        *HANDING_OVER,
        "mapmyworld.simulation.simulated_recording",
    }  # its pool runs to its end
