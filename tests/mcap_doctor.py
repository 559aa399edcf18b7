"""What `mcap doctor` asks of a file, and more: read from its bytes alone, by the specification.

Source: https://mcap.dev/spec, and the checks that the Go command makes. Nothing here is shared
with the library that writes the files.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = range(9, 14)
SUMMARY_OFFSET, DATA_END = 14, 15
_IN_SUMMARY = {
    SCHEMA, CHANNEL, CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET
}  # fmt: skip


@dataclass
class Record:
    code: int
    start: int
    body: bytes

    @property
    def length(self) -> int:
        return 9 + len(self.body)


class Fields:
    """The fields of a record, one after the other."""

    def __init__(self, body: bytes) -> None:
        self._body, self._at = body, 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.raw(size), "little")

    def raw(self, size: int) -> bytes:
        if self._at + size > len(self._body):
            raise ValueError("a record is shorter than its fields")
        self._at += size
        return self._body[self._at - size : self._at]

    def text(self) -> str:
        return self.raw(self.number(4)).decode("utf-8")

    def data(self, size: int = 4) -> bytes:
        return self.raw(self.number(size))

    def pairs(self, first: int, second: int) -> list[tuple[int, int]]:
        end = self.number(4) + self._at
        found = []
        while self._at < end:
            found.append((self.number(first), self.number(second)))
        return found

    def texts(self) -> dict[str, str]:
        end = self.number(4) + self._at
        found = {}
        while self._at < end:
            key = self.text()
            found[key] = self.text()
        return found


def records(data: bytes, start: int = 0) -> Iterator[Record]:
    at = start
    while at < len(data):
        if at + 9 > len(data):
            raise ValueError("a record's head is cut")
        code, size = struct.unpack_from("<BQ", data, at)
        if at + 9 + size > len(data):
            raise ValueError(f"record {code} at {at} is cut")
        yield Record(code, at, data[at + 9 : at + 9 + size])
        at += 9 + size


@dataclass
class Patient:
    """What was seen so far."""

    faults: list[str] = field(default_factory=list)
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    last_ns: int = 0
    first_ns: int = 2**64
    chunks: dict[int, dict[str, Any]] = field(default_factory=dict)
    kinds: Counter[int] = field(default_factory=Counter)

    def ask(self, truth: bool, complaint: str) -> None:
        if not truth:
            self.faults.append(complaint)


def doctor(data: bytes) -> list[str]:
    """Everything that is wrong with a file, one line each; empty where it is sound."""
    patient = Patient()
    try:
        _examine(data, patient)
    except (ValueError, struct.error, RuntimeError, zstandard.ZstdError) as error:
        patient.faults.append(f"cannot be read: {error}")
    return patient.faults


def _examine(data: bytes, p: Patient) -> None:
    p.ask(data[:8] == MAGIC and data[-8:] == MAGIC, "magic is missing at the start or the end")
    found = list(records(data[:-8], 8))
    codes = [record.code for record in found]
    p.ask(codes[0] == HEADER and codes.count(HEADER) == 1, "one header must come first")
    p.ask(codes[-1] == FOOTER and codes.count(FOOTER) == 1, "one footer must come last")
    p.ask(codes.count(DATA_END) == 1, "there must be one end of data")
    end = codes.index(DATA_END)
    header = Fields(found[0].body)
    p.ask(header.text() in {"", "ros1", "ros2"}, "the profile is not a well-known one")
    p.ask(header.text() != "", "the library is not named")
    _data_section(found[1:end], p)
    crc = Fields(found[end].body).number(4)
    whole = zlib.crc32(data[: found[end].start])
    p.ask(crc in {0, whole}, "checksum of the data section")  # 0: the writer gives none
    _summary(found[end + 1 : -1], found[-1], data, p)
    _indexes(found, p)


def _data_section(found: list[Record], p: Patient) -> None:
    for k, record in enumerate(found):
        p.kinds[record.code] += 1
        if record.code == CHUNK:
            after = k + 1
            while after < len(found) and found[after].code == MESSAGE_INDEX:
                after += 1
            _chunk(record, found[k + 1 : after], p)
        elif record.code == MESSAGE_INDEX:
            p.ask(found[k - 1].code in {CHUNK, MESSAGE_INDEX}, "a message index without its chunk")
        elif record.code == SCHEMA:
            _schema(record, p)
        elif record.code == CHANNEL:
            _channel(record, p)
        else:
            known = {ATTACHMENT, METADATA}
            p.ask(record.code in known, f"record {record.code} may not stand among the data")


def _schema(record: Record, p: Patient, *, again: bool = False) -> int:
    fields = Fields(record.body)
    number = fields.number(2)
    content = fields.text(), fields.text(), fields.data()
    p.ask(number != 0, "schema 0 is reserved")
    p.ask(bool(content[0]) and bool(content[1]), f"schema {number} has no name or encoding")
    if again:
        p.ask(p.schemas.get(number) == content, f"schema {number} of the summary is another")
    else:
        p.ask(p.schemas.get(number, content) == content, f"two schemas {number}")
        p.schemas[number] = content
    return number


def _channel(record: Record, p: Patient, *, again: bool = False) -> int:
    fields = Fields(record.body)
    number, schema = fields.number(2), fields.number(2)
    content = schema, fields.text(), fields.text(), fields.texts()
    p.ask(schema == 0 or schema in p.schemas, f"channel {number}: schema {schema} is unknown")
    if again:
        p.ask(p.channels.get(number) == content, f"channel {number} of the summary is another")
    else:
        p.ask(p.channels.get(number, content) == content, f"two channels {number}")
        p.channels[number] = content
    return number


def _chunk(record: Record, indexes: list[Record], p: Patient) -> None:
    fields = Fields(record.body)
    start, end, size, crc = (fields.number(n) for n in (8, 8, 8, 4))
    kind, packed = fields.text(), fields.data(8)
    plain = _unpacked(kind, packed, size)
    p.ask(len(plain) == size, f"chunk at {record.start}: size")
    p.ask(crc == zlib.crc32(plain), f"chunk at {record.start}: checksum")
    entries: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for inner in records(plain):
        if inner.code == SCHEMA:
            _schema(inner, p)
        elif inner.code == CHANNEL:
            _channel(inner, p)
        elif inner.code == MESSAGE:
            message = Fields(inner.body)
            channel, _, log_ns = message.number(2), message.number(4), message.number(8)
            p.ask(channel in p.channels, f"a message of channel {channel} comes before it")
            p.ask(log_ns >= p.last_ns, f"log time steps back at {log_ns}")
            p.first_ns, p.last_ns = min(p.first_ns, log_ns), max(p.last_ns, log_ns)
            p.counts[channel] += 1
            entries[channel].append((log_ns, inner.start))
        else:
            p.ask(False, f"record {inner.code} may not stand in a chunk")
    times = [time for rows in entries.values() for time, _ in rows]
    if times:
        p.ask((start, end) == (min(times), max(times)), f"chunk at {record.start}: times")
    reported = {}
    for index in indexes:
        fields = Fields(index.body)
        channel = fields.number(2)
        p.ask(channel not in reported, f"two indexes of channel {channel} for one chunk")
        reported[channel] = (index.start, sorted(fields.pairs(8, 8)))
    listed = {channel: rows for channel, (_, rows) in reported.items() if rows}
    p.ask(listed == {c: sorted(rows) for c, rows in entries.items()}, "message index is not true")
    p.chunks[record.start] = {
        "times": (start, end),
        "length": record.length,
        "offsets": {channel: start_ for channel, (start_, _) in reported.items()},
        "index length": sum(index.length for index in indexes),
        "kind": kind,
        "sizes": (len(packed), size),
        "channels": set(entries),
    }


def _unpacked(kind: str, packed: bytes, size: int) -> bytes:
    if kind == "zstd":
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if kind == "lz4":
        return bytes(lz4.frame.decompress(packed))
    if kind:
        raise ValueError(f"compression {kind!r} is unknown")
    return packed


def _summary(found: list[Record], footer: Record, data: bytes, p: Patient) -> None:
    fields = Fields(footer.body)
    start, offsets, crc = fields.number(8), fields.number(8), fields.number(4)
    p.ask(crc == zlib.crc32(data[start : footer.start + footer.length - 4]), "summary's checksum")
    p.ask(bool(found) and found[0].start == start, "the footer misplaces the summary")
    reported = [record for record in found if record.code == SUMMARY_OFFSET]
    p.ask(
        bool(reported) and reported[0].start == offsets,
        "the footer misplaces the summary's offsets",
    )
    p.ask(all(r.code in _IN_SUMMARY for r in found), "a record that is no summary stands in it")
    groups: list[list[Record]] = []
    for record in found:
        if not groups or groups[-1][0].code != record.code:
            groups.append([])
        groups[-1].append(record)
    codes = [group[0].code for group in groups]
    p.ask(len(codes) == len(set(codes)), "records of the summary are not grouped")
    true = {(g[0].code, g[0].start, sum(r.length for r in g)) for g in groups[:-1]}
    rows = [Fields(record.body) for record in reported]
    listed = {(r.number(1), r.number(8), r.number(8)) for r in rows}
    p.ask({row for row in listed if row[2]} == true, "summary offsets")
    schemas = {_schema(r, p, again=True) for r in found if r.code == SCHEMA}
    channels = {_channel(r, p, again=True) for r in found if r.code == CHANNEL}
    used = set().union(*(chunk["channels"] for chunk in p.chunks.values())) if p.chunks else set()
    p.ask(used <= channels, "the summary lacks a channel that is used")
    p.ask(
        {p.channels[c][0] for c in used & p.channels.keys()} - {0} <= schemas,
        "the summary lacks a schema",
    )
    _statistics([Fields(r.body) for r in found if r.code == STATISTICS], p)


def _statistics(found: list[Fields], p: Patient) -> None:
    p.ask(len(found) == 1, "there must be one record of statistics")
    for s in found:
        sizes = [s.number(n) for n in (8, 2, 4, 4, 4, 4)]
        true = [p.counts.total(), len(p.schemas), len(p.channels)]
        true += [p.kinds[ATTACHMENT], p.kinds[METADATA], len(p.chunks)]
        p.ask(sizes == true, f"statistics count {sizes}, there are {true}")
        times = s.number(8), s.number(8)
        p.ask(not p.counts or times == (p.first_ns, p.last_ns), "statistics misjudge the times")
        p.ask(dict(s.pairs(2, 8)) == dict(p.counts), "statistics miscount the messages")


def _indexes(found: list[Record], p: Patient) -> None:
    reported = {}
    for record in found:
        if record.code == CHUNK_INDEX:
            f = Fields(record.body)
            times, start, length = (f.number(8), f.number(8)), f.number(8), f.number(8)
            offsets, size, kind = dict(f.pairs(2, 8)), f.number(8), f.text()
            reported[start] = {
                "times": times,
                "length": length,
                "offsets": offsets,
                "index length": size,
                "kind": kind,
                "sizes": (f.number(8), f.number(8)),
            }
    true = {k: {n: v for n, v in c.items() if n != "channels"} for k, c in p.chunks.items()}
    p.ask(reported == true, "the chunk indexes are not true")
    for kind, index in ((METADATA, METADATA_INDEX), (ATTACHMENT, ATTACHMENT_INDEX)):
        there = {(r.start, r.length) for r in found if r.code == kind}
        rows = [Fields(r.body) for r in found if r.code == index]
        p.ask({(r.number(8), r.number(8)) for r in rows} == there, f"the index of {kind}")
