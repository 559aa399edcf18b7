"""rosbag2 recordings that are cut, renamed or lie: used as far as they go, and reported."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import zstandard
from log_builders import drive, write_rosbag2

from formats.logs import open_log
from mapmyworld.errors import LogError
from mapmyworld.types import LogSource


def recording(folder: Path, mode: str = "none") -> Path:
    return write_rosbag2(folder / "bag", drive(2, count=60), mode=mode)


def counted(log: LogSource) -> tuple[int, str]:
    return sum(1 for _ in log.messages()), " ".join(log.info().problems)


_READ = """
import re, sys
from pathlib import Path
from formats.logs import open_log
log = open_log(sys.argv[1:])
print(sum(1 for _ in log.messages()), *log.info().problems)
print(re.search("VmHWM: *(\\d+)", Path("/proc/self/status").read_text().replace("\t", ""))[1])
"""


def counted_apart(path: Path) -> tuple[str, int]:
    """What another process counts, and its peak of memory in MB."""
    done = subprocess.run(
        [sys.executable, "-c", _READ, path], capture_output=True, text=True, check=True
    )
    reported, peak_kb = done.stdout.splitlines()
    return reported, int(peak_kb) // 1000


def change(folder: Path, *statements: str) -> None:
    (path,) = folder.glob("*.db3")
    with closing(sqlite3.connect(path)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()


def test_messages_whose_topic_is_gone_are_counted(tmp_path: Path) -> None:
    folder = recording(tmp_path)
    whole, _ = counted(open_log([folder]))
    change(folder, "DELETE FROM topics WHERE name = '/odom'")
    count, said = counted(open_log([folder]))
    assert count == whole - 60
    assert "60 message(s) of channel number" in said


def test_a_file_that_was_renamed_is_read_beside_its_metadata(tmp_path: Path) -> None:
    folder = recording(tmp_path)
    whole, said = counted(open_log([folder]))
    assert said == ""
    (path,) = folder.glob("*.db3")
    path.rename(folder / "monday.db3")
    count, said = counted(open_log([folder]))
    assert count == whole
    assert "monday.db3: is read instead of missing files" in said
    assert "bag.db3: no such file" in said


def test_a_message_beyond_the_limit_is_left_out_unread(tmp_path: Path) -> None:
    """As many bytes as a hostile file likes would be read for one row."""
    folder = recording(tmp_path)
    whole, _ = counted(open_log([folder]))
    change(
        folder,
        "INSERT INTO messages (topic_id, timestamp, data)"
        " SELECT topic_id, timestamp, zeroblob(700000000) FROM messages LIMIT 1",
    )
    reported, peak_mb = counted_apart(folder)
    assert reported.startswith(f"{whole} ")
    assert "it claims 700000000 bytes, more than limits.chunk_mb allows" in reported
    assert peak_mb < 400


@pytest.mark.parametrize("kept", [0.3, 0.999])
def test_a_packed_file_that_is_cut_is_reported_by_its_own_name(kept: float, tmp_path: Path) -> None:
    folder = recording(tmp_path, "file")
    whole, said = counted(open_log([folder]))
    assert (whole, said) == (136, "")
    (path,) = folder.glob("*.zstd")
    path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    log = open_log([folder])
    try:
        said = counted(log)[1]
    except LogError as error:  # of a part so short that no message is in it
        said = str(error)
    assert f"{path}: the packed file is cut or damaged" in said
    assert "mapmyworld-" not in said


def test_a_file_packed_on_several_threads_is_unpacked_whole(tmp_path: Path) -> None:
    folder = recording(tmp_path, "file")
    (path,) = folder.glob("*.zstd")
    plain = zstandard.ZstdDecompressor().stream_reader(path.read_bytes()).read()
    frames = [plain[k : k + 20_000] for k in range(0, len(plain), 20_000)]
    skipped = (0x184D2A51).to_bytes(4, "little") + (3).to_bytes(4, "little") + b"abc"
    packer = zstandard.ZstdCompressor(write_checksum=True)
    path.write_bytes(skipped.join(packer.compress(frame) for frame in frames))
    assert counted(open_log([folder])) == (136, "")


def test_a_large_damaged_file_is_not_held_in_memory(tmp_path: Path) -> None:
    folder = recording(tmp_path)
    (path,) = folder.glob("*.db3")
    data = bytearray(path.read_bytes())
    data[100:200] = bytes(100)  # the head of the first page: SQLite gives nothing
    path.write_bytes(data)
    os.truncate(path, 1 << 30)
    reported, peak_mb = counted_apart(path)
    assert reported.startswith("136 ")
    assert peak_mb < 400
