"""Records of a ROS 1 bag, version 2.0: headers of named fields, chunks, messages.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

from struct import Struct

from formats.logs.block_files import DamagedBlockError, messages_of
from formats.logs.channels import Channel, Found, normalised_type
from formats.logs.compression import decompress, decompress_beginning

MAGIC = b"#ROSBAG V2.0\n"
OP_MESSAGE, OP_BAG_HEADER, OP_INDEX, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION = 2, 3, 4, 5, 6, 7
MAX_HEADER_BYTES = 1 << 20
U32 = Struct("<I").unpack_from
_TIME = Struct("<II").unpack_from

Fields = dict[bytes, bytes]


def parse_fields(header: bytes) -> Fields:
    """Named fields of a record header; DamagedBlockError where it is none."""
    fields: Fields = {}
    position = 0
    while position < len(header):
        if position + 4 > len(header):
            raise DamagedBlockError("a record header is cut")
        (length,) = U32(header, position)
        name, equals, value = header[position + 4 : position + 4 + length].partition(b"=")
        if position + 4 + length > len(header) or not equals:
            raise DamagedBlockError("a record header is no list of fields")
        fields[name] = value
        position += 4 + length
    return fields


def operation(fields: Fields) -> int:
    """What kind of record this is; -1 where the header does not say."""
    op = fields.get(b"op", b"")
    return op[0] if len(op) == 1 else -1


def field_u32(fields: Fields, name: bytes) -> int:
    """A field of four bytes as a number; `DamagedBlockError` for another size."""
    return int(U32(_sized(fields, name, 4))[0])


def _sized(fields: Fields, name: bytes, size: int) -> bytes:
    value = fields.get(name, b"")
    if len(value) != size:
        raise DamagedBlockError(f"a record header has no {name.decode()}")
    return value


def parse_connection(fields: Fields, data: bytes) -> tuple[int, Channel]:
    """Id and channel of a connection record."""
    described = parse_fields(data)
    caller = described.get(b"callerid")
    topic = fields.get(b"topic") or described.get(b"topic", b"")
    channel = Channel(
        topic.decode("utf-8", "replace"),
        normalised_type(described.get(b"type", b"").decode("utf-8", "replace")),
        "ros1",
        "ros1msg",
        described.get(b"message_definition", b""),
        described.get(b"md5sum", b"").decode("ascii", "replace"),
        described.get(b"latching", b"0") == b"1",
        {"callerid": caller.decode("utf-8", "replace")} if caller is not None else {},
    )
    return field_u32(fields, b"conn"), channel


def block_messages(data: bytes, connections: dict[int, Channel]) -> list[Found]:
    """Messages of a chunk, or of a message's own record, in file order.

    Of a chunk in which the file ends, those that can be had. Connections found on the way go into
    `connections`. DamagedBlockError where something is wrong.
    """
    header, body = _sized_part(data, 0)
    fields = parse_fields(data[header:body])
    if operation(fields) != OP_CHUNK:
        return messages_of(data, _next_record, connections)
    start, length = body + 4, int(U32(data, body)[0])
    stored, size = memoryview(data)[start:], field_u32(fields, b"size")
    compression = fields.get(b"compression", b"").decode("ascii", "replace")
    if len(stored) < length:
        plain = decompress_beginning(stored, compression, size)
        return messages_of(plain, _next_record, connections, to_the_end=False)
    return messages_of(decompress(stored, compression, size), _next_record, connections)


def _next_record(
    data: bytes, position: int, connections: dict[int, Channel], records: list[Found]
) -> int:
    header, body = _sized_part(data, position)
    start, after = _sized_part(data, body)
    fields = parse_fields(data[header:body])
    op = operation(fields)
    if op == OP_MESSAGE:
        seconds, nanoseconds = _TIME(_sized(fields, b"time", 8))
        time = int(seconds) * 1_000_000_000 + int(nanoseconds)
        records.append((time, field_u32(fields, b"conn"), data[start:after]))
    elif op == OP_CONNECTION:
        key, channel = parse_connection(fields, data[start:after])
        connections[key] = channel
    return after


def _sized_part(data: bytes, position: int) -> tuple[int, int]:
    """Where the bytes begin and end whose number stands at `position`."""
    start = position + 4
    end = start + int(U32(data, position)[0]) if start <= len(data) else start
    if end > len(data):
        raise DamagedBlockError("a record is cut")
    return start, end
