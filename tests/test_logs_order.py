"""Time order: within blocks, across blocks that overlap, and at equal times."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_builders import Make, write_mcap, write_ros1, write_rosbag2

from formats.logs import open_log
from formats.logs.channels import Block, Channel, Record
from formats.logs.recorded_log import in_time_order
from mapmyworld.types import TextMessage

CHANNEL = Channel("/t", "", "")


@settings(max_examples=300)
@given(
    st.lists(st.lists(st.integers(0, 30), min_size=1, max_size=8), max_size=8),
    st.sampled_from([0, 10, 30, 10**6]),
)
def test_blocks_merge_as_one_stable_sort_would(times: list[list[int]], limit: int) -> None:
    """Also where little may be open at once, so that blocks are dropped and read again."""
    content = [
        [(t, CHANNEL, bytes([number, at])) for at, t in enumerate(block)]
        for number, block in enumerate(times)
    ]
    blocks = [Block(number, 0, min(block), max(block), None) for number, block in enumerate(times)]

    def read(block: Block) -> list[Record]:
        return content[block.offset]

    expected = sorted((r for block in content for r in block), key=lambda r: r[0])
    assert list(in_time_order(blocks, read, limit)) == expected


def test_only_overlapping_blocks_are_open_together() -> None:
    """No block is read before its time: memory does not grow with the log."""
    blocks = [Block(i, 0, 10 * i, 10 * i + 12, None) for i in range(50)]
    opened: list[int] = []

    def read(block: Block) -> list[Record]:
        opened.append(block.offset)
        return [(t, CHANNEL, b"") for t in range(block.start_ns, block.end_ns + 1)]

    for time, _, _ in in_time_order(blocks, read):
        assert opened[-1] <= time // 10
        assert time // 10 - 1 <= opened[-1]


def test_what_reading_a_block_raises_comes_where_its_records_would_have_come() -> None:
    def read(block: Block) -> list[Record]:
        if block.offset == 2:
            raise OSError("gone")
        return [(block.start_ns, CHANNEL, b"")]

    records = in_time_order([Block(i, 0, i, i, None) for i in range(9)], read)
    assert [next(records)[0], next(records)[0]] == [0, 1]
    with pytest.raises(OSError, match="gone"):
        next(records)


def test_chunks_that_all_start_with_a_wrong_time_do_not_all_stay_in_memory() -> None:
    """Each block holds one record of time zero, as recorders under load write them."""
    alive = peak = 0

    class Payload(bytes):
        def __new__(cls, size: int) -> Payload:
            nonlocal alive, peak
            alive += 1
            peak = max(peak, alive)
            return super().__new__(cls, size)

        def __del__(self) -> None:
            nonlocal alive
            alive -= 1

    blocks = [Block(i, 0, 0, 1000 + i, None) for i in range(100)]

    def read(block: Block) -> list[Record]:
        return [(t, CHANNEL, Payload(1000)) for t in (0, 1000 + block.offset)]

    count = sum(1 for _ in in_time_order(blocks, read, 20_000))
    assert count == 200
    assert peak < 30


TIMES = [5, 5, 3, 9, 1, 9, 9, 2, 2, 5, 7, 0]


def texts(path: Path) -> list[tuple[int, str]]:
    found = []
    for raw in open_log([path]).messages():
        message = raw.decode()
        assert isinstance(message, TextMessage)
        found.append((raw.log_time_ns, message.text))
    return found


def test_every_container_sorts_by_log_time_and_keeps_ties_in_file_order(tmp_path: Path) -> None:
    """Messages that were recorded out of order, in small chunks that all overlap."""
    start = 10**18
    built = {
        ros: [
            ("/a" if i % 2 else "/b", "std_msgs/msg/String", start + t, Make(ros).text(f"{i}"))
            for i, t in enumerate(TIMES)
        ]
        for ros in (1, 2)
    }
    paths = [
        write_ros1(tmp_path / "a.bag", built[1], chunk_bytes=150),
        write_ros1(tmp_path / "b.bag", built[1]),
        write_mcap(tmp_path / "a.mcap", built[2], chunk_bytes=80),
        write_mcap(tmp_path / "b.mcap", built[2], use_chunking=False),
        write_rosbag2(tmp_path / "c", built[2]),
    ]
    order = sorted(range(len(TIMES)), key=lambda i: TIMES[i])
    expected = [(start + TIMES[i], f"{i}") for i in order]
    for path in paths:
        assert texts(path) == expected


def test_parts_given_together_merge_and_ties_follow_their_order(tmp_path: Path) -> None:
    parts = []
    for part in range(2):
        built = [
            ("/t", "std_msgs/msg/String", 10**18 + i, Make(1).text(f"{part}-{i}")) for i in range(4)
        ]
        parts.append(write_ros1(tmp_path / f"{part}.bag", built))
    got = [raw.decode().text for raw in open_log(parts).messages()]  # type: ignore[union-attr]
    assert got == [f"{part}-{i}" for i in range(4) for part in range(2)]
