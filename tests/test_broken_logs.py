"""Sound drives, spoiled as recordings are: what is sound is used, and the rest is reported."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from robust.ailments import AILMENTS, Ailment, Entry
from robust.corpus import drive_entries
from robust.trials import try_command

from formats.recording_files import LogWriter


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    """A sound drive, looked at once: compiling kernels may take longer than a hang."""
    entries = list(drive_entries())
    sound = written(entries, tmp_path_factory.mktemp("sound"))
    assert not try_command(["inspect", "log", sound], seconds=300.0).fault
    return entries


def spoiled(ailment: Ailment, entries: list[Entry], folder: Path) -> str:
    return written(ailment.spoil(list(entries)), folder)


def written(entries: Iterable[Entry], folder: Path) -> str:
    path = folder / "log.mcap"
    with LogWriter(path) as writer:
        for topic, message, time in entries:
            writer.write(topic, message, time)
    return str(path)


@pytest.mark.parametrize("ailment", AILMENTS, ids=lambda ailment: ailment.name)
def test_inspect_log_indicates_what_is_wrong(
    ailment: Ailment, entries: list[Entry], tmp_path: Path
) -> None:
    found = try_command(["inspect", "log", spoiled(ailment, entries, tmp_path)])
    assert not found.fault
    assert found.exit_code in ailment.exits
    assert ailment.words in found.stdout + found.stderr


@pytest.mark.slow
@pytest.mark.parametrize("ailment", AILMENTS, ids=lambda ailment: ailment.name)
def test_build_uses_what_is_sound(ailment: Ailment, entries: list[Entry], tmp_path: Path) -> None:
    command = ["build", spoiled(ailment, entries, tmp_path), "-o", str(tmp_path / "map.db"), "-q"]
    found = try_command(command, seconds=120.0)
    assert not found.fault
    assert found.exit_code in ailment.exits
    if found.exit_code != 2:
        assert try_command(["inspect", "map", str(tmp_path / "map.db")]).exit_code == 0
