"""Recordings of rosbag2 compressed as a whole: .db3.zstd and .mcap.zstd."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import zstandard

from formats.limits import check_unpacked
from formats.logs.block_files import BlockFile
from formats.logs.channels import Index, Record
from formats.logs.clock_steps import ClockStep
from formats.logs.mcap_file import open_mcap
from formats.logs.mcap_records import MAGIC as MCAP_MAGIC
from formats.logs.rosbag2 import SqliteBag
from mapmyworld.errors import LogError

_BLOCK_BYTES = 1 << 20
_SKIPPED = range(0x184D2A50, 0x184D2A60)  # first words of frames that hold no data
_LONGEST_HEAD = 18  # bytes of a frame's header, at most
_REPEATED = 1  # kind of block that stores one byte, however long it is


class PackedBag:
    """A Container over a .db3.zstd or .mcap.zstd file, unpacked into a temporary one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._inner: SqliteBag | BlockFile | None = None
        self._problems = list[str]()

    @property
    def name(self) -> str:
        return f"{self._unpacked().name}, packed with zstd"

    @property
    def clock_step(self) -> ClockStep | None:
        return self._unpacked().clock_step

    def files(self) -> tuple[Path, ...]:
        return (self.path,)

    def index(self) -> Index:
        inner = self._unpacked()
        try:
            index = inner.index()
        except LogError as error:
            raise LogError(self._named(str(error)), problems=self._problems) from error
        problems = [*self._problems, *map(self._named, index.problems)]
        return replace(index, problems=problems)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        self.index()  # whose errors have the file's own name
        return self._unpacked().records(topics)

    def losses(self) -> tuple[str, ...]:
        inner = self._unpacked()
        return (*self._problems, *map(self._named, inner.losses()))

    def _named(self, text: str) -> str:
        """A message by the file's own name: that of the temporary one changes with every run."""
        return text.replace(str(self._unpacked().path), str(self.path))

    def _unpacked(self) -> SqliteBag | BlockFile:
        if self._inner is None:
            folder = Path(tempfile.mkdtemp(prefix="mapmyworld-"))
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            file = folder / self.path.stem
            if not unpack_zstd(self.path, file):
                self._problems.append(
                    f"{self.path}: the packed file is cut or damaged: unpacked as far as it goes"
                )
            with file.open("rb") as stream:
                is_mcap = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
            self._inner = open_mcap(file) if is_mcap else SqliteBag(file)
        return self._inner


def unpack_zstd(source: Path, target: Path) -> bool:
    """Decompresses a file of one frame or several as far as it goes; whether that is all.

    Raises `LogError` where nothing of it can be.
    """
    with source.open("rb") as packed, target.open("wb") as plain:
        reader = zstandard.ZstdDecompressor().stream_reader(
            packed, read_across_frames=True, closefd=False
        )
        try:
            while block := reader.read(_BLOCK_BYTES):
                check_unpacked(plain.tell() + len(block), source, LogError)
                plain.write(block)
        except zstandard.ZstdError as error:
            if plain.tell() == 0:
                raise LogError(f"{source}: damaged zstd file ({error})") from error
            return False
        return _is_whole(packed, source.stat().st_size)


def _is_whole(packed: BinaryIO, size: int) -> bool:
    """Whether the last frame ends where the file does: a reader ends in silence where it is cut."""
    position = 0
    while position < size:
        packed.seek(position)
        head = packed.read(_LONGEST_HEAD)
        if int.from_bytes(head[:4], "little") in _SKIPPED:
            position += 8 + int.from_bytes(head[4:8], "little")
            continue
        try:
            has_checksum = zstandard.get_frame_parameters(head).has_checksum
            position = _end_of_blocks(packed, position + zstandard.frame_header_size(head))
        except (zstandard.ZstdError, EOFError):
            return False
        position += 4 if has_checksum else 0
    return position == size


def _end_of_blocks(packed: BinaryIO, position: int) -> int:
    """Where the blocks end of which the first stands at `position`; EOFError where they do not."""
    is_last = False
    while not is_last:
        packed.seek(position)
        head = packed.read(3)
        if len(head) < 3:
            raise EOFError
        word = int.from_bytes(head, "little")
        is_last = bool(word & 1)
        position += 3 + (1 if (word >> 1) & 3 == _REPEATED else word >> 3)
    return position
