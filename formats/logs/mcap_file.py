"""MCAP files: by their summary, or by reading them through where it is missing or damaged."""

from __future__ import annotations

import os
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from isal.isal_zlib import crc32
from mcap.records import ChunkIndex, Header, Statistics

from formats.logs.block_files import BlockFile, DamagedBlockError, borne_out
from formats.logs.channels import Block, Channel, Index, Record
from formats.logs.files import UnpackedFile, begins_about_as
from formats.logs.mcap_chunks import chunk_beginning, chunk_data
from formats.logs.mcap_records import (
    CHUNK,
    CHUNK_INDEX,
    FOOTER,
    FOOTER_BYTES,
    HEAD_BYTES,
    HEADER,
    MAGIC,
    STATISTICS,
    Definitions,
    chunk_messages,
    parsed,
    record_head,
)
from formats.logs.mcap_scan import scan
from mapmyworld.errors import LogError

_FOOTER = Struct("<QQI")
_MAX_SUMMARY_BYTES = 1 << 29


def open_mcap(file: UnpackedFile, name: str = "MCAP") -> BlockFile:
    """An MCAP file as a container of records."""
    return BlockFile(file, name, read_index, read_block)


class _NoSummaryError(Exception):
    """The file has no summary, or one that does not list all: allowed, and no damage."""


def read_index(stream: BinaryIO, path: Path) -> Index:
    """From the summary where that is whole, else from the chunks.

    Raises `LogError` where it is no MCAP file.
    """
    if not begins_about_as(stream.read(len(MAGIC)), MAGIC):
        raise LogError(f"{path}: not an MCAP file: its first bytes are not MCAP's")
    size = os.fstat(stream.fileno()).st_size
    try:
        index = _from_summary(stream, size)
        index = borne_out(
            index,
            lambda place: _opcode_at(stream, place) == CHUNK,
            lambda: scan(stream, path, size),
            path,
        )
    except _NoSummaryError:
        index = scan(stream, path, size)
    except DamagedBlockError as error:
        index = scan(stream, path, size)
        index.problems.insert(0, f"{path}: {error}: chunks were read one by one")
    index.details[:0] = _header_details(stream)
    return index


def _header_details(stream: BinaryIO) -> list[tuple[str, str]]:
    stream.seek(len(MAGIC))
    head = stream.read(HEAD_BYTES)
    if len(head) < HEAD_BYTES or head[0] != HEADER:
        return []
    try:
        header = parsed(Header, stream.read(min(record_head(head)[1], 1 << 16)))
    except DamagedBlockError:
        return []
    return [("library", header.library), ("profile", header.profile)]


def _summary_bytes(stream: BinaryIO, size: int) -> bytes:
    """The checked summary section; empty where the file has none."""
    stream.seek(max(size - FOOTER_BYTES, 0))
    footer = stream.read(FOOTER_BYTES)
    if len(footer) < FOOTER_BYTES or not footer.endswith(MAGIC) or footer[0] != FOOTER:
        raise DamagedBlockError("the file was not closed (no footer)")
    start, _, crc = _FOOTER.unpack_from(footer, HEAD_BYTES)
    if start == 0:
        return b""
    length = size - FOOTER_BYTES - start
    if not 0 <= length <= _MAX_SUMMARY_BYTES:
        raise DamagedBlockError("the footer points outside the file")
    stream.seek(start)
    summary = stream.read(length)
    if crc and crc32(footer[: HEAD_BYTES + 16], crc32(summary)) != crc:
        raise DamagedBlockError("the summary's checksum is wrong")
    return summary


def _from_summary(stream: BinaryIO, size: int) -> Index:
    """The index as the summary has it; DamagedBlockError where it does not say all of it."""
    data = _summary_bytes(stream, size)
    definitions, chunks = Definitions(), list[ChunkIndex]()
    statistics: Statistics | None = None
    position = 0
    while position + HEAD_BYTES <= len(data):
        opcode, length = record_head(data, position)
        content = data[position + HEAD_BYTES : position + HEAD_BYTES + length]
        if len(content) < length:
            raise DamagedBlockError("the summary is cut")
        definitions.take(opcode, content)
        if opcode == CHUNK_INDEX:
            chunks.append(parsed(ChunkIndex, content))
        elif opcode == STATISTICS:
            statistics = parsed(Statistics, content)
        position += HEAD_BYTES + length
    if statistics is None or not _says_all(statistics, chunks, definitions):
        raise _NoSummaryError
    # No seek goes beyond 63 bits; at the file's end there is no chunk either.
    blocks = [_block(chunk, size) for chunk in chunks]
    counts = statistics.channel_message_counts
    return Index(definitions.channels, counts, blocks, _chunk_details(chunks))


def _block(chunk: ChunkIndex, size: int) -> Block:
    """Where a chunk is and what it holds; None as channels where it does not say."""
    channels = frozenset(chunk.message_index_offsets) or None
    offset = min(chunk.chunk_start_offset, size)
    return Block(offset, 0, chunk.message_start_time, chunk.message_end_time, channels)


def _says_all(statistics: Statistics, chunks: list[ChunkIndex], definitions: Definitions) -> bool:
    counts = statistics.channel_message_counts
    spoken = {key for key, count in counts.items() if count}
    return (
        len(chunks) == statistics.chunk_count
        and (statistics.message_count == 0 or statistics.chunk_count > 0)
        and sum(counts.values()) == statistics.message_count
        and spoken <= set(definitions.channels)
    )


def _opcode_at(stream: BinaryIO, place: int) -> int:
    stream.seek(place)
    return next(iter(stream.read(1)), 0)


def _chunk_details(chunks: list[ChunkIndex]) -> list[tuple[str, str]]:
    plain = sum(c.uncompressed_size for c in chunks)
    stored = sum(c.compressed_size for c in chunks)
    names = sorted({c.compression or "none" for c in chunks})
    ratio = f" ({1 - stored / plain:.1%} saved)" if plain else ""
    return [("compression", ", ".join(names) + ratio), ("chunks", str(len(chunks)))]


def read_block(
    stream: BinaryIO, block: Block, wanted: dict[int, Channel], check: bool = True
) -> list[Record]:
    """The block's wanted records, its checksum checked where `check`."""
    stream.seek(block.offset)
    ignored = Definitions()
    if block.bare:
        messages = chunk_messages(stream.read(block.length), ignored, to_the_end=False)
    elif block.length:  # the file ends in this chunk
        content = stream.read(HEAD_BYTES + block.length)[HEAD_BYTES:]
        messages = chunk_messages(chunk_beginning(content), ignored, to_the_end=False)
    else:
        messages = chunk_messages(chunk_data(stream, check), ignored)
    return [(time, wanted[key], data) for time, key, data in messages if key in wanted]
