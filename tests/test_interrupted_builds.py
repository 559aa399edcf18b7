"""Builds that somebody or something stops: the map keeps what is finished, and goes on the same."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from pathlib import Path

import pytest
from robust import corpus, kills
from robust.trials import Outcome, try_command

from cli.interrupts import ending_with, forget_wish
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


@pytest.mark.parametrize("name", ["plain.mcap", "whole.bag", "plain.db3", "a.log", "a.clf.bz2"])
@pytest.mark.parametrize("fate", ["removed", "cut", "replaced"])
def test_a_log_that_vanishes_during_a_build(
    logs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, fate: str
) -> None:
    """It is there when the plan is made and gone, or another, when it is to be followed."""
    log, path = tmp_path / name, tmp_path / "map.db"
    log.write_bytes(logs[name].read_bytes())
    follow = pipeline.track

    def late(*arguments: object) -> object:
        if fate == "removed":
            log.unlink()
        else:
            data = logs[name].read_bytes()
            log.write_bytes(data[: len(data) // 2] if fate == "cut" else data[::-1])
        return follow(*arguments)  # type: ignore[arg-type]

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
            told = f"{outcome.exit_code}\n{outcome.fault}\0{outcome.stderr}"
            os.write(writing, told.encode())
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


def test_a_signal_waits_until_the_import_machinery_is_left() -> None:
    """There it would leave the lock of all imports held, and threads waiting for it for ever."""
    source = "def importing():\n    raise_signal(SIGUSR1)\n    left.append(True)\n"
    left: list[bool] = []
    scope = {"raise_signal": signal.raise_signal, "SIGUSR1": signal.SIGUSR1, "left": left}
    exec(compile(source, "<frozen importlib._bootstrap>", "exec"), scope)
    before = signal.signal(signal.SIGUSR1, ending_with(_Ended))
    try:
        scope["importing"]()  # type: ignore[operator]
        with pytest.raises(_Ended):
            time.sleep(5.0)
    finally:
        forget_wish()
        signal.signal(signal.SIGUSR1, before)
    assert left == [True]


def test_a_signal_is_heeded_at_once_elsewhere() -> None:
    before = signal.signal(signal.SIGUSR1, ending_with(_Ended))
    try:
        with pytest.raises(_Ended):
            signal.raise_signal(signal.SIGUSR1)
    finally:
        forget_wish()
        signal.signal(signal.SIGUSR1, before)
