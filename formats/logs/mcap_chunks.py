"""Chunks of an MCAP file: whole and checked, or as much as a cut file still has of one."""

from __future__ import annotations

from typing import BinaryIO

from isal.isal_zlib import crc32  # ten times as fast as zlib's

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError
from formats.logs.compression import decompress, decompress_beginning
from formats.logs.mcap_records import CHUNK, HEAD_BYTES, parse_chunk_head, record_head


def chunk_data(stream: BinaryIO, check: bool = True) -> bytes:
    """Decompressed bytes, checked where `check`, of the chunk at the stream's position."""
    head = stream.read(HEAD_BYTES)
    opcode, length = record_head(head) if len(head) == HEAD_BYTES else (0, 0)
    if opcode != CHUNK or length > limits().chunk_bytes:
        raise DamagedBlockError("there is no chunk")
    content = stream.read(length)
    chunk = parse_chunk_head(content[:128])
    stored = memoryview(content)[chunk.data_at : chunk.data_at + chunk.data_bytes]
    if len(content) < length or len(stored) < chunk.data_bytes:
        raise DamagedBlockError("the file ends in it")
    data = decompress(stored, chunk.compression, chunk.size)
    if check and chunk.crc and crc32(data) != chunk.crc:
        raise DamagedBlockError("its checksum is wrong")
    return data


def chunk_beginning(content: bytes) -> bytes:
    """What can be had of a chunk in which the file ends."""
    try:
        chunk = parse_chunk_head(content[:128])
    except DamagedBlockError:
        return b""
    return decompress_beginning(content[chunk.data_at :], chunk.compression, chunk.size)
