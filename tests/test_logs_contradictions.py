"""Files that contradict themselves: an index that points elsewhere, chunks of several frames."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from log_builders import drive, write_mcap, write_ros1

from formats.logs import open_log

_MAGIC = 8
_CHUNK, _CHUNK_INDEX, _DATA_END = 6, 8, 15
Change = Callable[[bytes], bytes]


def changed_mcap(path: Path, change: Change, opcode: int = _CHUNK_INDEX) -> Path:
    """The records of one kind changed; the summary stays where it is found, without checksum."""
    data, parts, position, summary = path.read_bytes(), list[bytes](), _MAGIC, 0
    while position < len(data) - _MAGIC:
        kind, length = struct.unpack_from("<BQ", data, position)
        content = data[position + 9 : position + 9 + length]
        content = change(content) if kind == opcode else content
        position += 9 + length
        if kind == 2:
            content = struct.pack("<QQI", summary, 0, 0)
        parts.append(struct.pack("<BQ", kind, len(content)) + content)
        summary = _MAGIC + sum(map(len, parts)) if kind == _DATA_END else summary
    path.write_bytes(data[:_MAGIC] + b"".join(parts) + data[-_MAGIC:])
    return path


def changed_bag(path: Path, old: Change, place: bytes, size: int) -> Path:
    """Every field of that name changed; it keeps its length."""
    data = bytearray(path.read_bytes())
    at = data.find(place)
    while at >= 0:
        start = at + len(place)
        data[start : start + size] = old(bytes(data[start : start + size]))
        at = data.find(place, at + 1)
    path.write_bytes(data)
    return path


def read(path: Path) -> tuple[int, list[int], str]:
    """How many messages, their log times, and what is said to be lost."""
    log = open_log([path])
    times = [raw.log_time_ns for raw in log.messages()]
    return len(times), times, " ".join(log.info().problems)


def test_a_bag_whose_index_points_elsewhere_is_read_through(tmp_path: Path) -> None:
    messages = drive(1, count=60)
    path = write_ros1(tmp_path / "a.bag", messages, chunk_bytes=4000)
    whole = read(path)
    changed_bag(path, lambda _: struct.pack("<Q", 13), b"chunk_pos=", 8)
    count, times, said = read(path)
    assert (count, times) == whole[:2]
    assert said == ""


@pytest.mark.parametrize("where", [_MAGIC, 1 << 40])
def test_a_summary_that_points_elsewhere_is_not_believed(where: int, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", drive(2, count=60), chunk_bytes=4000)
    whole = read(path)

    def moved(content: bytes) -> bytes:
        return content[:16] + struct.pack("<Q", where) + content[24:]

    count, times, said = read(changed_mcap(path, moved))
    assert (count, times) == whole[:2]
    assert said == ""


def test_a_summary_that_points_beyond_any_file_is_not_believed(tmp_path: Path) -> None:
    """By more than 63 bits, each chunk elsewhere."""
    path = write_mcap(tmp_path / "a.mcap", drive(2, count=60), chunk_bytes=4000)
    whole = read(path)

    def moved(content: bytes) -> bytes:
        return content[:23] + b"\xff" + content[24:]

    count, times, said = read(changed_mcap(path, moved))
    assert (count, times) == whole[:2]
    assert said == ""


def test_a_summary_that_hides_channels_hides_nothing(tmp_path: Path) -> None:
    """Every second chunk is said to hold a channel that does not exist, and no other."""
    path = write_mcap(tmp_path / "a.mcap", drive(2, count=200), chunk_bytes=4000)
    whole = len(list(open_log([path]).messages(["/scan"])))
    seen = list[bytes]()

    def hidden(content: bytes) -> bytes:
        seen.append(content)
        if len(seen) % 2:
            return content
        (length,) = struct.unpack_from("<I", content, 32)
        return content[:32] + struct.pack("<IHQ", 10, 999, 0) + content[36 + length :]

    log = open_log([changed_mcap(path, hidden)])
    assert len(list(log.messages(["/scan"]))) == whole
    assert log.info().problems == ()


def test_chunks_that_begin_before_their_index_says_so_are_in_order(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", drive(2, count=60), chunk_bytes=4000)

    def late(content: bytes) -> bytes:
        (start,) = struct.unpack_from("<Q", content)
        return struct.pack("<Q", start + 2_500_000) + content[8:]

    count, times, said = read(changed_mcap(path, late))
    assert (count, times, said) == (136, sorted(times), "")


def halves(compress: Callable[[bytes], bytes]) -> Change:
    """A chunk's data anew, as two frames one after the other."""

    def change(content: bytes) -> bytes:
        (length,) = struct.unpack_from("<I", content, 28)
        name, data = content[32 : 32 + length], content[40 + length :]
        plain = zstandard.ZstdDecompressor().decompress(data) if name == b"zstd" else data
        plain = lz4.frame.decompress(data) if name == b"lz4" else plain
        middle = len(plain) // 2
        frames = compress(plain[:middle]) + compress(plain[middle:])
        return content[: 32 + length] + struct.pack("<Q", len(frames)) + frames

    return change


@pytest.mark.parametrize(
    ("name", "compress"),
    [("zstd", zstandard.ZstdCompressor().compress), ("lz4", lz4.frame.compress)],
)
def test_chunks_of_several_frames_are_read_whole(
    name: str, compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    path = write_mcap(tmp_path / "a.mcap", drive(2, count=60), compression=name)
    whole = read(path)
    assert whole[2] == ""
    count, times, said = read(changed_mcap(path, halves(compress), _CHUNK))
    assert (count, times) == whole[:2]
    assert "skipped" not in said


def test_a_bag_compressed_on_several_threads_is_read_whole() -> None:
    from formats.logs.compression import decompress

    plain = bytes(range(256)) * 300
    parts = [plain[k : k + 10_000] for k in range(0, len(plain), 10_000)]
    several = b"".join(bz2.compress(part) for part in parts)
    assert decompress(several, "bz2", len(plain)) == plain
    with pytest.raises(Exception, match="76800 bytes where 76801"):
        decompress(several, "bz2", len(plain) + 1)
    with pytest.raises(Exception, match="1001 bytes where 1000"):
        decompress(several, "bz2", 1000)
    for name, compress in (("zstd", zstandard.ZstdCompressor().compress),
                           ("lz4", lz4.frame.compress)):  # fmt: skip
        frames = b"".join(compress(part) for part in parts)
        with pytest.raises(Exception, match="bytes where 15000"):
            decompress(frames, name, 15_000)
