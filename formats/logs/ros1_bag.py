"""ROS 1 bags: by their index, or by reading them through where it is missing or damaged."""

from __future__ import annotations

from pathlib import Path
from struct import Struct
from typing import BinaryIO

from formats.limits import limits
from formats.logs.block_files import BlockFile, DamagedBlockError, borne_out
from formats.logs.channels import Block, Channel, Index, Payload, Record
from formats.logs.compression import (
    MAX_DEFINITION_BYTES,
    decompress,
    decompress_beginning,
)
from formats.logs.files import begins_about_as
from formats.logs.ros1_records import (
    MAGIC,
    MAX_HEADER_BYTES,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX,
    OP_MESSAGE,
    U32,
    Fields,
    chunk_records,
    field_time,
    field_u32,
    field_u64,
    operation,
    parse_connection,
    parse_fields,
    with_channels,
)
from mapmyworld.errors import LogError

_PAIR = Struct("<II")
_SEARCH_BYTES = 1 << 20
_OLD_VERSIONS = {b"V1.0", b"V1.1", b"V1.2", b"V1.3"}


def open_ros1_bag(path: Path) -> BlockFile:
    """A ROS 1 bag as a container of records."""
    return BlockFile(path, "ROS 1 bag", read_index, read_block)


def read_index(stream: BinaryIO, path: Path) -> Index:
    """From the bag's index where that is whole, else from its chunks.

    Raises `LogError` where it is no ROS 1 bag of version 2.0.
    """
    start = stream.read(len(MAGIC))
    if not begins_about_as(start, MAGIC) or start[8:12] in _OLD_VERSIONS:
        raise LogError(
            f"{path}: not a ROS 1 bag of version 2.0: if it is an older bag, "
            "`rosbag migrate` converts it"
        )
    size = path.stat().st_size
    try:
        index = _indexed(stream, size)
    except (DamagedBlockError, EOFError) as error:
        index = _scanned(stream, path, size)
        index.problems.insert(0, f"{path}: no usable index ({error}): chunks were read one by one")
        return index
    return borne_out(
        index,
        lambda place: _is_chunk(stream, place, size),
        lambda: _scanned(stream, path, size),
        path,
    )


def _record(stream: BinaryIO, size: int) -> tuple[Fields, int, int]:
    """Fields, start and length of the data of the record at the stream's position."""
    start = stream.tell()
    head = stream.read(4)
    if len(head) < 4:
        raise EOFError("the file ends")
    (length,) = U32(head)
    if length > min(MAX_HEADER_BYTES, size - start):
        raise DamagedBlockError(f"record header at byte {start} claims {length} bytes")
    fields = parse_fields(stream.read(length))
    tail = stream.read(4)
    if len(tail) < 4:
        raise EOFError("the file ends")
    return fields, start + 8 + length, int(U32(tail)[0])


def _indexed(stream: BinaryIO, size: int) -> Index:
    fields, _, _ = _record(stream, size)
    position = field_u64(fields, b"index_pos")
    if operation(fields) != OP_BAG_HEADER or not 0 < position <= size:
        raise DamagedBlockError("the recording was not closed")
    index = Index()
    stream.seek(position)
    chunks = field_u32(fields, b"chunk_count")
    while stream.tell() < size:
        fields, start, length = _record(stream, size)
        if length > min(MAX_DEFINITION_BYTES, size - start):
            raise DamagedBlockError(f"an index record claims {length} bytes")
        data = stream.read(length)
        if operation(fields) == OP_CONNECTION:
            key, channel = parse_connection(fields, data)
            index.channels[key] = channel
        elif operation(fields) == OP_CHUNK_INFO:
            index.blocks.append(_chunk_info(fields, data, index.counts, size))
    if len(index.blocks) != chunks or not set(index.counts) <= set(index.channels):
        raise DamagedBlockError("the index is incomplete")
    index.details = [("compression", _compression(stream, index)), ("chunks", str(chunks))]
    return index


def _is_chunk(stream: BinaryIO, place: int, size: int) -> bool:
    stream.seek(place)
    try:
        return operation(_record(stream, size)[0]) == OP_CHUNK
    except (DamagedBlockError, EOFError):
        return False


def _compression(stream: BinaryIO, index: Index) -> str:
    """Of the first chunk; writers do not change it on the way."""
    if not index.blocks:
        return "none"
    stream.seek(index.blocks[0].offset)
    fields, _, _ = _record(stream, 1 << 62)
    return fields.get(b"compression", b"?").decode("ascii", "replace")


def _chunk_info(fields: Fields, data: bytes, counts: dict[int, int], size: int) -> Block:
    position = field_u64(fields, b"chunk_pos")
    pairs = dict(_PAIR.iter_unpack(data[: len(data) // 8 * 8]))
    if position >= size or len(pairs) != field_u32(fields, b"count"):
        raise DamagedBlockError("the index contradicts itself")
    for key, count in pairs.items():
        counts[key] = counts.get(key, 0) + count
    start, end = field_time(fields, b"start_time"), field_time(fields, b"end_time")
    return Block(position, 0, start, end, frozenset(pairs))


def read_block(
    stream: BinaryIO, block: Block, wanted: dict[int, Channel], _check: bool = True
) -> list[Record]:
    """The chunk's wanted records; bags have no checksums to check."""
    stream.seek(block.offset)
    if block.bare:
        records = chunk_records(stream.read(block.length), wanted, to_the_end=False)
        return with_channels(records, wanted)
    data, whole = _chunk_data(stream, 1 << 62, cut=block.length > 0)
    return with_channels(chunk_records(data, wanted, to_the_end=whole), wanted)


def _chunk_data(stream: BinaryIO, size: int, *, cut: bool) -> tuple[bytes, bool]:
    """Decompressed bytes of the chunk at the stream's position, and whether they are all."""
    try:
        fields, _, length = _record(stream, size)
    except EOFError as error:
        raise DamagedBlockError("the file ends in it") from error
    if operation(fields) != OP_CHUNK or length > limits().chunk_bytes:
        raise DamagedBlockError("there is no chunk")
    data = stream.read(length)
    compression = fields.get(b"compression", b"").decode("ascii", "replace")
    plain_size = field_u32(fields, b"size")
    if len(data) == length:
        return decompress(data, compression, plain_size), True
    if not cut:
        raise DamagedBlockError("the file ends in it")
    return decompress_beginning(data, compression, plain_size), False


def _scanned(stream: BinaryIO, path: Path, size: int) -> Index:
    """An index made by reading every chunk; bad stretches are skipped and reported."""
    index = Index(details=[("index", "none, rebuilt")])
    position = len(MAGIC)
    while position < size:
        stream.seek(position)
        try:
            position = _scan_record(stream, position, size, index)
        except EOFError:
            index.problems.append(
                f"{path}: the file ends in the record at byte {position}; "
                f"{sum(index.counts.values())} message(s) before that were kept"
            )
            break
        except DamagedBlockError as error:
            following = _next_chunk(stream, position + 1, size)
            index.problems.append(
                f"{path}: damaged at byte {position} ({error}): "
                f"{following - position} bytes skipped"
            )
            position = following
    index.details.append(("chunks", str(len(index.blocks))))
    return index


def _scan_record(stream: BinaryIO, position: int, size: int, index: Index) -> int:
    """Takes in the record at `position` and gives the position after it."""
    fields, start, length = _record(stream, size)
    op = operation(fields)
    after = start + length
    if op == OP_CHUNK:
        stream.seek(position)
        data, whole = _chunk_data(stream, size, cut=True)
        records = chunk_records(data, {}, index.channels, to_the_end=whole)
        _add_block(index, records, Block(position, 0 if whole else length, 0, 0, None))
        if not whole:
            raise EOFError("the file ends in a chunk")
        return after
    if after > size:
        raise EOFError("the file ends in a record")
    if length > (MAX_DEFINITION_BYTES if op == OP_CONNECTION else limits().chunk_bytes):
        raise DamagedBlockError(f"a record claims {length} bytes")
    if op == OP_CONNECTION:
        key, channel = parse_connection(fields, stream.read(length))
        index.channels[key] = channel
    elif op == OP_MESSAGE:
        stream.seek(position)
        data = stream.read(after - position)
        records = chunk_records(data, {}, index.channels)
        _add_block(index, records, Block(position, after - position, 0, 0, None, bare=True))
    elif op not in {OP_BAG_HEADER, OP_INDEX, OP_CHUNK_INFO}:
        raise DamagedBlockError("there is no record")
    return after


def _add_block(index: Index, records: list[tuple[int, int, Payload]], block: Block) -> None:
    if not records:
        return
    for _, key, _ in records:
        index.counts[key] = index.counts.get(key, 0) + 1
    times = [record[0] for record in records]
    keys = frozenset(record[1] for record in records)
    index.blocks.append(Block(block.offset, block.length, min(times), max(times), keys, block.bare))


def _next_chunk(stream: BinaryIO, position: int, size: int) -> int:
    """Where the next chunk starts, at or after `position`; the file's size where none does."""
    while position < size:
        stream.seek(position)
        window = stream.read(_SEARCH_BYTES + 128)
        at = window.find(b"op=\x05")
        while 0 <= at < _SEARCH_BYTES + 64:
            start = _chunk_start(window, at)
            if start is not None:
                return position + start
            at = window.find(b"op=\x05", at + 1)
        position += _SEARCH_BYTES
    return size


def _chunk_start(window: bytes, at: int) -> int | None:
    """The start of the chunk header in which `op=` stands at `at`; None where it is no header."""
    for start in range(max(at - 64, 0), max(at - 7, 0)):
        (length,) = U32(window, start)
        if not at + 4 - start - 4 <= length <= 96:
            continue
        try:
            fields = parse_fields(window[start + 4 : start + 4 + length])
        except DamagedBlockError:
            continue
        if operation(fields) == OP_CHUNK and b"compression" in fields and b"size" in fields:
            return start
    return None
