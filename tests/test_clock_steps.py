"""A clock that was set back while a log was recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from room_drive import START_NS, STEP_NS, Entry, drive, write

from formats.logs import open_log
from mapmyworld.types import TransformsMessage

BACK_NS = 7 * 10**9
AT_NS = START_NS + 100 * STEP_NS


def set_back(entries: tuple[Entry, ...]) -> list[Entry]:
    """The same messages from a clock that was set back by 7 s after 10 s."""
    return [
        entry
        if entry[2] < AT_NS or isinstance(entry[1], TransformsMessage)
        else (
            entry[0],
            replace(entry[1], stamp_ns=entry[1].stamp_ns - BACK_NS),  # type: ignore[call-arg, union-attr]
            entry[2] - BACK_NS,
        )
        for entry in entries
    ]


@pytest.mark.parametrize("ending", ["mcap", "bag"])
def test_a_clock_that_was_set_back_is_told(tmp_path: Path, ending: str) -> None:
    """The two times were mixed, repeated stamps were dropped, and the exit code was 0."""
    path = tmp_path / f"log.{ending}"
    write(path, set_back(drive(200).entries))
    log = open_log([path])
    assert len(list(log.messages())) == len(drive(200).entries)
    assert any("the clock was set back by" in loss for loss in log.losses())


def test_topics_that_were_written_one_after_the_other_are_no_set_clock(tmp_path: Path) -> None:
    entries = sorted(drive(200).entries, key=lambda entry: entry[0])
    write(tmp_path / "log.mcap", entries)
    log = open_log([tmp_path / "log.mcap"])
    assert len(list(log.messages())) == len(entries)
    assert log.losses() == ()
