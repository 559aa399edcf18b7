"""ROS 1 bags: by their index, or by reading them through where it is missing or damaged."""

from __future__ import annotations

import os
import re
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from formats.limits import limits
from formats.logs.block_files import (
    BlockFile,
    DamagedBlockError,
    borne_out,
    next_place,
)
from formats.logs.channels import Block, Channel, Index, Record
from formats.logs.compression import (
    MAX_DEFINITION_BYTES,
    decompress,
    decompress_beginning,
)
from formats.logs.files import UnpackedFile, begins_about_as
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
)
from mapmyworld.errors import LogError

_PAIR = Struct("<II")
# The length of a header of at most 96 bytes, that of its first field, and the kind of a chunk.
_CHUNK_HEAD = re.compile(rb"(?=[\x0d-\x60]\0\0\0[\x04-\x40]\0\0\0.{0,64}?op=\x05)", re.DOTALL)
_OLD_VERSIONS = {b"V1.0", b"V1.1", b"V1.2", b"V1.3"}


def open_ros1_bag(file: UnpackedFile) -> BlockFile:
    """A ROS 1 bag as a container of records."""
    return BlockFile(file, "ROS 1 bag", read_index, read_block)


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
    size = os.fstat(stream.fileno()).st_size
    try:
        index = _indexed(stream, size)
    except DamagedBlockError as error:
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
        raise DamagedBlockError("the file ends in it")
    (length,) = U32(head)
    if length > min(MAX_HEADER_BYTES, size - start):
        raise DamagedBlockError(f"record header at byte {start} claims {length} bytes")
    fields = parse_fields(stream.read(length))
    tail = stream.read(4)
    if len(tail) < 4:
        raise DamagedBlockError("the file ends in it")
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
    except DamagedBlockError:
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
        records = chunk_records(stream.read(block.length), {}, to_the_end=False)
    else:
        data, whole = _chunk_data(stream, 1 << 62, cut=block.length > 0)
        records = chunk_records(data, {}, to_the_end=whole)
    return [(time, wanted[key], data) for time, key, data in records if key in wanted]


def _chunk_data(stream: BinaryIO, size: int, *, cut: bool) -> tuple[bytes, bool]:
    """Decompressed bytes of the chunk at the stream's position, and whether they are all."""
    fields, _, length = _record(stream, size)
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
        try:
            position = _scan_record(stream, position, size, index)
        except DamagedBlockError as error:
            following = next_place(stream, position + 1, size, _CHUNK_HEAD, _is_chunk_head)
            index.problems.append(
                f"{path}: damaged or cut at byte {position} ({error}): "
                f"{following - position} bytes skipped"
            )
            position = following
    index.details.append(("chunks", str(len(index.blocks))))
    return index


def _scan_record(stream: BinaryIO, position: int, size: int, index: Index) -> int:
    """Takes in the record at `position` and gives the position after it."""
    stream.seek(position)
    fields, start, length = _record(stream, size)
    op = operation(fields)
    after = start + length
    if op == OP_CHUNK:
        stream.seek(position)
        data, whole = _chunk_data(stream, size, cut=True)
        records = chunk_records(data, index.channels, to_the_end=whole)
        index.add(records, position, 0 if whole else length)
        if not whole:
            raise DamagedBlockError("the file ends in a chunk")
        return after
    if after > size:
        raise DamagedBlockError("the file ends in a record")
    if length > (MAX_DEFINITION_BYTES if op == OP_CONNECTION else limits().chunk_bytes):
        raise DamagedBlockError(f"a record claims {length} bytes")
    if op == OP_CONNECTION:
        key, channel = parse_connection(fields, stream.read(length))
        index.channels[key] = channel
    elif op == OP_MESSAGE:
        stream.seek(position)
        data = stream.read(after - position)
        index.add(chunk_records(data, index.channels), position, after - position, bare=True)
    elif op not in {OP_BAG_HEADER, OP_INDEX, OP_CHUNK_INFO}:
        raise DamagedBlockError("there is no record")
    return after


def _is_chunk_head(_position: int, data: bytes) -> bool:
    (length,) = U32(data)
    try:
        fields = parse_fields(data[4 : 4 + length])
    except DamagedBlockError:
        return False
    return operation(fields) == OP_CHUNK and b"compression" in fields and b"size" in fields
