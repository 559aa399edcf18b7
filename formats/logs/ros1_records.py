"""Records of a ROS 1 bag, version 2.0: headers of named fields, chunks, messages.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

from struct import Struct

from formats.logs.block_files import DamagedBlockError
from formats.logs.channels import Channel, Payload, Record, normalised_type, payload

MAGIC = b"#ROSBAG V2.0\n"
OP_MESSAGE, OP_BAG_HEADER, OP_INDEX, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION = 2, 3, 4, 5, 6, 7
MAX_HEADER_BYTES = 1 << 20
U32 = Struct("<I").unpack_from
_U64 = Struct("<Q").unpack_from
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


def field_u64(fields: Fields, name: bytes) -> int:
    """A field of eight bytes as a number; `DamagedBlockError` for another size."""
    return int(_U64(_sized(fields, name, 8))[0])


def field_time(fields: Fields, name: bytes) -> int:
    """Nanoseconds of a field of seconds and nanoseconds."""
    seconds, nanoseconds = _TIME(_sized(fields, name, 8))
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _sized(fields: Fields, name: bytes, size: int) -> bytes:
    value = fields.get(name, b"")
    if len(value) != size:
        raise DamagedBlockError(f"a record header has no {name.decode()}")
    return value


def parse_connection(fields: Fields, data: bytes) -> tuple[int, Channel]:
    """Id and channel of a connection record."""
    described = parse_fields(data)
    topic = fields.get(b"topic") or described.get(b"topic", b"")
    channel = Channel(
        topic.decode("utf-8", "replace"),
        normalised_type(described.get(b"type", b"").decode("utf-8", "replace")),
        "ros1",
        "ros1msg",
        described.get(b"message_definition", b""),
        described.get(b"md5sum", b"").decode("ascii", "replace"),
        described.get(b"latching", b"0") == b"1",
        {
            k.decode(): v.decode("utf-8", "replace")
            for k, v in described.items()
            if k == b"callerid"
        },
    )
    return field_u32(fields, b"conn"), channel


class _Layout:
    """Where op, conn and time stand in message headers of one length, as one writer lays them."""

    __slots__ = ("connection_at", "gaps", "time_at")

    def __init__(self, header: bytes) -> None:
        at, position = {}, 0
        while position < len(header):
            (length,) = U32(header, position)
            name, _, value = header[position + 4 : position + 4 + length].partition(b"=")
            at[name] = position + 4 + len(name) + 1, len(value)
            position += 4 + length
        self.connection_at, self.time_at = at[b"conn"][0], at[b"time"][0]
        changing = sorted((start, start + size) for start, size in (at[b"conn"], at[b"time"]))
        edges = [0, *(edge for pair in changing for edge in pair), len(header)]
        # What stands between the two values must be the same for the layout to apply.
        self.gaps = tuple(
            (start, end, header[start:end])
            for start, end in zip(edges[::2], edges[1::2], strict=True)
            if end > start
        )


_layouts: dict[int, _Layout] = {}


def chunk_records(
    data: bytes,
    wanted: dict[int, Channel],
    connections: dict[int, Channel] | None = None,
    *,
    to_the_end: bool = True,
) -> list[tuple[int, int, Payload]]:
    """Messages of a decompressed chunk as (log time, connection, payload), in file order.

    Connections found on the way go into `connections`. Where `to_the_end` is False, damage ends
    the list instead of raising DamagedBlockError.
    """
    records: list[tuple[int, int, Payload]] = []
    position, end = 0, len(data)
    try:
        while position < end:
            position = _next_record(data, position, end, wanted, connections, records)
    except DamagedBlockError:
        if to_the_end:
            raise
    return records


def _next_record(
    data: bytes,
    position: int,
    end: int,
    wanted: dict[int, Channel],
    connections: dict[int, Channel] | None,
    records: list[tuple[int, int, Payload]],
) -> int:
    if position + 8 > end:
        raise DamagedBlockError("a record is cut")
    (size,) = U32(data, position)
    body = position + 4 + size
    if body + 4 > end:
        raise DamagedBlockError("a record is cut")
    (length,) = U32(data, body)
    after: int = body + 4 + length
    if after > end:
        raise DamagedBlockError("a record is cut")
    header = data[position + 4 : body]
    layout = _layouts.get(size)
    if layout is not None and all(header[a:b] == same for a, b, same in layout.gaps):
        (connection,) = U32(header, layout.connection_at)
        if connection in wanted or connections is not None:
            seconds, nanoseconds = _TIME(header, layout.time_at)
            time = seconds * 1_000_000_000 + nanoseconds
            records.append((time, connection, payload(data, body + 4, after)))
        return after
    fields = parse_fields(header)
    op = operation(fields)
    if op == OP_MESSAGE:
        connection, time = field_u32(fields, b"conn"), field_time(fields, b"time")
        if connection in wanted or connections is not None:
            records.append((time, connection, payload(data, body + 4, after)))
        if len(fields) == 3:
            _layouts[size] = _Layout(header)
    elif op == OP_CONNECTION and connections is not None:
        key, channel = parse_connection(fields, data[body + 4 : after])
        connections[key] = channel
    return after


def with_channels(
    records: list[tuple[int, int, Payload]], channels: dict[int, Channel]
) -> list[Record]:
    """The records of known, wanted channels."""
    return [(time, channels[key], data) for time, key, data in records if key in channels]
