"""A clock that was set back while a log was recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from room_drive import START_NS, STEP_NS, Entry, drive, write

from formats.logs import open_log
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.memory_map import MemoryMap
from mapmyworld.pipeline import build_map
from mapmyworld.sensing import survey_log
from mapmyworld.types import RawMessage, TransformsMessage

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
def test_what_follows_a_clock_that_was_set_back_is_moved(tmp_path: Path, ending: str) -> None:
    """The two times were mixed, repeated stamps were dropped, and the exit code was 0."""
    path = tmp_path / f"log.{ending}"
    write(path, set_back(drive(200).entries))
    log = open_log([path])
    survey = survey_log(log)
    assert any("the clock was set back by 7.0 s" in loss for loss in survey.losses)
    plain = tmp_path / f"plain.{ending}"
    drive(200).write(plain)
    found, expected = (
        [(raw.topic, raw.log_time_ns, raw.stamp_ns, decoded_stamp(raw)) for raw in one.messages()]
        for one in (log, open_log([plain]))
    )
    assert found == expected
    built = build_map(log, MemoryMap(), Config(), Silent())
    assert built.frames == 200
    assert built.duration_s == pytest.approx(19.9)
    assert any("the clock was set back" in loss for loss in built.losses)


def decoded_stamp(raw: RawMessage) -> int:
    message = raw.decode()
    if isinstance(message, TransformsMessage):
        return message.transforms[0].stamp_ns
    return int(message.stamp_ns)  # type: ignore[union-attr]


def test_topics_that_were_written_one_after_the_other_are_no_set_clock(tmp_path: Path) -> None:
    entries = sorted(drive(200).entries, key=lambda entry: entry[0])
    write(tmp_path / "log.mcap", entries)
    log = open_log([tmp_path / "log.mcap"])
    assert len(list(log.messages())) == len(entries)
    assert log.losses() == ()
