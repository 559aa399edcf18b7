"""Files that are read block by block: ROS 1 bags and MCAP files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import BinaryIO

from formats.logs.channels import Block, Channel, Index, Record
from formats.logs.files import open_binary
from formats.logs.time_order import in_time_order


class DamagedBlockError(Exception):
    """A block that cannot be read; the message says why."""


IndexReader = Callable[[BinaryIO, Path], Index]
BlockReader = Callable[[BinaryIO, Block, dict[int, Channel], bool], list[Record]]
"""Reads a block's records on these channels; the last argument says whether to check sums."""


class BlockFile:
    """A Container over one file of blocks: a ROS 1 bag or an MCAP file."""

    def __init__(
        self, path: Path, name: str, read_index: IndexReader, read_block: BlockReader
    ) -> None:
        self.path = path
        self.name = name
        self._read_index, self._read_block = read_index, read_block
        self._index: Index | None = None
        self._losses: list[str] = []
        self._checked: set[int] = set()

    def index(self) -> Index:
        """Blocks and channels; read from the file's summary, or by looking through all of it."""
        if self._index is None:
            with open_binary(self.path) as stream:
                self._index = self._read_index(stream, self.path)
        return self._index

    def files(self) -> tuple[Path, ...]:
        """The file itself."""
        return (self.path,)

    def losses(self) -> tuple[str, ...]:
        """Of the index, and of what was read since."""
        return (*self.index().problems, *self._losses)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Records in log-time order, block by block."""
        index = self.index()
        wanted = {
            key: channel
            for key, channel in index.channels.items()
            if topics is None or channel.topic in topics
        }
        blocks = [
            b for b in index.blocks if b.channels is None or not b.channels.isdisjoint(wanted)
        ]
        losses: list[str] = []
        self._losses = losses
        with open_binary(self.path) as stream:

            def read(block: Block) -> list[Record]:
                check = block.offset not in self._checked  # once is enough for one log
                try:
                    records = self._read_block(stream, block, wanted, check)
                    self._checked.add(block.offset)
                    return records
                except DamagedBlockError as error:
                    losses.append(
                        f"{self.path}: chunk at byte {block.offset} skipped: {error}; "
                        f"lost {(block.end_ns - block.start_ns) * 1e-9:.2f} s of recording"
                    )
                    return []

            yield from in_time_order(blocks, read)
