"""A clock that was set back while a log was recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from room_drive import START_NS, STEP_NS, Entry, drive, write

from formats.converting import convert_log
from formats.database import MemoryMap
from formats.logs import open_log
from mapmyworld.api import Silent
from mapmyworld.config import Config
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


@pytest.mark.parametrize("ending", ["mcap", "bag", "db3"])
def test_what_follows_a_clock_that_was_set_back_is_moved(tmp_path: Path, ending: str) -> None:
    """The two times were mixed, repeated stamps were dropped, and the exit code was 0."""
    path = tmp_path / f"log.{ending}"
    write(path, set_back(drive(200).entries))
    log = open_log([path])
    survey = survey_log(log)
    assert any("the clock was set back by 7.0 s" in line for line in survey.info.problems)
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


@pytest.mark.parametrize("ending", ["mcap", "bag", "db3"])
@pytest.mark.parametrize("into", ["mcap", "bag", "db3"])
def test_a_converted_log_is_as_if_the_clock_had_not_been_set(
    tmp_path: Path, ending: str, into: str
) -> None:
    """Its messages came in the order of two mixed times, and nothing was moved."""
    write(tmp_path / f"log.{ending}", set_back(drive(200).entries))
    drive(200).write(tmp_path / f"plain.{ending}")
    found = {}
    for name in ("log", "plain"):
        result = convert_log(
            open_log([tmp_path / f"{name}.{ending}"]), tmp_path / f"{name}_new.{into}"
        )
        new = open_log([tmp_path / f"{name}_new.{into}"])
        found[name] = [
            (raw.topic, raw.log_time_ns, raw.stamp_ns, decoded_stamp(raw)) for raw in new.messages()
        ]
        assert new.info().problems == ()
        assert any("set back by 7.0 s" in loss for loss in result.losses) == (name == "log")
    assert found["log"] == found["plain"]


def test_a_part_of_a_log_is_taken_by_the_mended_clock(tmp_path: Path) -> None:
    write(tmp_path / "log.mcap", set_back(drive(200).entries))
    part = {"topics": frozenset({"/scan"}), "start_s": 12.0, "duration_s": 2.0}
    convert_log(open_log([tmp_path / "log.mcap"]), tmp_path / "part.mcap", **part)
    times = [raw.log_time_ns for raw in open_log([tmp_path / "part.mcap"]).messages()]
    assert times == [START_NS + k * STEP_NS for k in range(120, 140)]


def test_rows_of_a_damaged_file_are_moved_as_well(tmp_path: Path) -> None:
    path = tmp_path / "log.db3"
    write(path, set_back(drive(200).entries))
    data = bytearray(path.read_bytes())
    middle = 6 * len(data) // 10 // 4096 * 4096
    data[middle : middle + 8192] = b"\xff" * 8192
    path.write_bytes(data)
    log = open_log([path])
    times = [raw.log_time_ns for raw in log.messages()]
    assert times == sorted(times)
    assert any("damaged" in loss for loss in log.info().problems)
    assert times[-1] == START_NS + 199 * STEP_NS


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
    assert log.info().problems == ()
