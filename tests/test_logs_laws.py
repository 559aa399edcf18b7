"""The laws of `LogSource`, for every kind of log there is. A new reader adds one row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest
from log_builders import drive, write_mcap, write_ros1, write_rosbag2
from log_laws import check_cut, check_laws
from test_logs_carmen import SMALL as CARMEN
from test_logs_tum import make as make_tum

from formats.logs.opening_logs import _READERS
from mapmyworld.types import Message, MessageKind


def _carmen(folder: Path) -> Path:
    path = folder / "a.log"
    path.write_text(CARMEN.replace("nan", "1.25"))
    return path


def _tum(folder: Path) -> Path:
    path = make_tum(folder / "tum")
    (path / "camera.txt").write_text("5 5 4 3\n")
    return path


LOGS: dict[str, Callable[[Path], Path]] = {
    "CARMEN": _carmen,
    "TUM RGB-D": _tum,
    "MCAP": lambda folder: write_mcap(folder / "a.mcap", drive(2, 6)),
    "ROS 1 bag": lambda folder: write_ros1(folder / "a.bag", drive(1, 6)),
    "rosbag2": lambda folder: write_rosbag2(folder / "bag", drive(2, 6)),
    "packed rosbag2": lambda folder: write_rosbag2(folder / "bag", drive(2, 6), mode="file"),
}
CONTAINERS = {"MCAP", "ROS 1 bag", "rosbag2", "packed rosbag2"}  # cut at every record elsewhere


def test_every_reader_has_a_log_here(tmp_path: Path) -> None:
    logs = list[Path]()
    for number, make in enumerate(LOGS.values()):
        (folder := tmp_path / str(number)).mkdir()
        logs.append(make(folder))
    files = [file for log in logs for file in ([log] if log.is_file() else log.iterdir())]
    starts = {file: file.read_bytes()[:65536] for file in files if file.is_file()}
    for reader in _READERS:
        if not reader.endings:
            assert any(reader.fits(b"", log) for log in logs if log.is_dir()), reader.says
            continue
        assert any(reader.fits(start, file) for file, start in starts.items()), reader.says
        assert all(reader.names(file) for file in starts if reader.fits(starts[file], file))


def test_every_type_of_message_has_its_kind() -> None:
    kinds = [message.kind for message in get_args(Message)]
    assert set(kinds) == set(MessageKind) - {MessageKind.OTHER}


@pytest.mark.parametrize("kind", LOGS)
def test_a_reader_keeps_the_laws(kind: str, tmp_path: Path) -> None:
    check_laws(LOGS[kind](tmp_path), tmp_path)


@pytest.mark.parametrize("kind", [kind for kind in LOGS if kind not in CONTAINERS])
def test_a_text_log_cut_anywhere_gives_what_precedes_the_cut(kind: str, tmp_path: Path) -> None:
    log = LOGS[kind](tmp_path)
    for text in [log] if log.is_file() else sorted(log.glob("*.txt")):
        whole = text.read_bytes()
        for cut in range(len(whole)):
            check_cut(log, text, whole, cut)
        text.write_bytes(whole)
