"""Chunks decompressed: whole ones checked in size, cut ones as far as they go."""

from __future__ import annotations

import bz2
from contextlib import suppress
from io import BytesIO
from typing import Any

import lz4.frame
import zstandard

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError

# What claims more is damaged, and must not exhaust memory.
MAX_DEFINITION_BYTES = 1 << 26
Buffer = bytes | memoryview
_ERRORS = (RuntimeError, OSError, EOFError, ValueError, MemoryError, zstandard.ZstdError)


def decompress(data: Buffer, compression: str, size: int) -> bytes:
    """The chunk's `size` bytes; DamagedBlockError where they cannot be had."""
    if not 0 <= size <= limits().chunk_bytes:
        raise DamagedBlockError(f"it claims {size} bytes, more than limits.chunk_mb allows")
    try:
        with _reader(data, compression) as reader:
            plain: bytes = reader.read(size + 1)  # so that a lying chunk cannot fill the memory
    except _ERRORS as error:
        raise DamagedBlockError(f"{compression} data damaged ({error})") from error
    if len(plain) != size:
        raise DamagedBlockError(f"{len(plain)} bytes where {size} are announced")
    return plain


def decompress_beginning(data: Buffer, compression: str, size: int) -> bytes:
    """As much of a cut chunk as can be had, at most `size` bytes; possibly nothing."""
    size, found = min(size, limits().chunk_bytes), bytearray()
    with suppress(*_ERRORS, DamagedBlockError), _reader(data, compression) as reader:
        # Of bz2 and lz4, `read` gives nothing where it ends in damage; of zstd, `read1` never ends.
        read = reader.read if compression == "zstd" else reader.read1
        while len(found) < size and (block := read(min(size - len(found), 1 << 16))):
            found += block
    return bytes(found)


def _reader(data: Buffer, compression: str) -> Any:
    """A file of the plain bytes.

    Of all frames, where compressing on several threads left one after the other.
    """
    if compression in {"", "none"}:
        return BytesIO(bytes(data))
    if compression == "zstd":
        # A decompressor of one's own each time: they must not be shared by threads.
        return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
    if compression == "lz4":
        return lz4.frame.open(BytesIO(data))
    if compression == "bz2":
        return bz2.open(BytesIO(data))
    raise DamagedBlockError(f"compression {compression!r} is unknown")
