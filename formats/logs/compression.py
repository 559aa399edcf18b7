"""Chunks decompressed: whole ones checked in size, cut ones as far as they go."""

from __future__ import annotations

import bz2
from contextlib import suppress

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
        plain = _decompress(data, compression, size)
    except _ERRORS as error:
        raise DamagedBlockError(f"{compression} data damaged ({error})") from error
    if len(plain) != size:
        raise DamagedBlockError(f"{len(plain)} bytes where {size} are announced")
    return plain


def _decompress(data: Buffer, compression: str, size: int) -> bytes:
    """At most `size` + 1 bytes, but of what is not compressed."""
    if compression in {"", "none"}:
        return bytes(data)
    if compression == "zstd":
        # A decompressor of one's own each time: they must not be shared by threads.
        decompressor = zstandard.ZstdDecompressor()
        with decompressor.stream_reader(data, read_across_frames=True) as reader:
            return bytes(reader.read(size + 1))
    if compression == "lz4":
        return _bounded(lz4.frame.LZ4FrameDecompressor, data, size)
    if compression == "bz2":
        return _bounded(bz2.BZ2Decompressor, data, size)
    raise DamagedBlockError(f"compression {compression!r} is unknown")


_Made = type[lz4.frame.LZ4FrameDecompressor] | type[bz2.BZ2Decompressor]


def _bounded(made: _Made, data: Buffer, size: int) -> bytes:
    """At most `size` + 1 bytes, so that a lying chunk cannot fill the memory.

    Of all frames, where compressing on several threads left one after the other.
    """
    decompressor = made()
    plain = bytes(decompressor.decompress(data, max_length=size + 1))
    while decompressor.eof and decompressor.unused_data and len(plain) <= size:
        rest = decompressor.unused_data
        decompressor = made()
        part = bytes(decompressor.decompress(rest, max_length=size + 1 - len(plain)))
        if not part:
            break
        plain += part
    return plain


def decompress_beginning(data: bytes, compression: str, size: int) -> bytes:
    """As much of a cut chunk as can be had, at most `size` bytes; possibly nothing."""
    size, found = min(size, limits().chunk_bytes), bytearray()
    with suppress(*_ERRORS, DamagedBlockError):
        if compression != "zstd":
            return _decompress(data, compression, size)[:size]
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            while len(found) < size and (block := reader.read(min(size - len(found), 1 << 16))):
                found += block
    return bytes(found)
