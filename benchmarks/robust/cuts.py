"""A log cut, or with a byte flipped, at many places: what can be had must be had."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from formats.logs import open_log
from formats.logs.mcap_records import MAGIC, record_head
from formats.logs.recorded_log import RecordedLog
from mapmyworld.errors import LogError

Record = tuple[str, int, bytes]
_KINDS = {1: "header", 2: "footer", 3: "schema", 4: "channel", 5: "message", 6: "chunk",
          7: "message index", 8: "chunk index", 9: "attachment", 11: "statistics",
          14: "summary offset", 15: "data end"}  # fmt: skip


@dataclass
class Cuts:
    tried: int = 0
    kinds: dict[str, int] = field(default_factory=dict)
    """Record in which the cut fell -> how often."""
    lost: int = 0
    """Messages that were lost in all."""
    faults: list[str] = field(default_factory=list)


def cut_everywhere(source: Path, scratch: Path, count: int, kind: Literal["cut", "flip"]) -> Cuts:
    """Damages copies of a log at `count` places and in every kind of record, and reads them."""
    data, found = source.read_bytes(), Cuts()
    wanted, spans = records_of(source), top_level(data)
    places = {round((k + 0.5) * len(data) / count) for k in range(count)}
    first = {name: (start + end) // 2 for start, end, name in reversed(spans)}
    for place in sorted(places | set(first.values())):
        start, end, name = next(s for s in spans if s[0] <= place < s[1])
        scratch.write_bytes(_damaged(data, place, kind))
        found.tried += 1
        found.kinds[name] = found.kinds.get(name, 0) + 1
        try:
            kept = records_of(scratch)
        except LogError as error:
            kept = []
            if _before(source, start):
                found.faults.append(f"{source.name} {kind} at {place} ({name}): {error}")
        found.lost += len(wanted) - len(kept)
        _judge(found, source, place, name, kind, wanted, kept, (start, end))
    return found


def _judge(
    found: Cuts, source: Path, place: int, name: str, kind: str,
    wanted: list[Record], kept: list[Record], span: tuple[int, int],
) -> None:  # fmt: skip
    """What stood before a cut must be there; of a flipped byte only its own record may be lost."""
    whole = _before(source, span[0])
    where = f"{source.name} {kind} at {place} ({name})"
    if kind == "cut" and kept[:whole] != wanted[:whole]:
        found.faults.append(f"{where}: {len(kept)} of {whole} messages before it")
    after = len(wanted) - _before(source, span[1])
    if kind == "flip" and len(kept) < whole + after:
        found.faults.append(f"{where}: {len(kept)} messages, {whole} before and {after} behind it")


def _damaged(data: bytes, place: int, kind: str) -> bytes:
    if kind == "cut":
        return data[:place]
    return data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :]


def records_of(path: Path) -> list[Record]:
    """Topic, log time and payload of all messages."""
    log = open_log([path])
    assert isinstance(log, RecordedLog)
    return [(channel.topic, time, bytes(data)) for time, channel, data in log.records()]


def top_level(data: bytes) -> list[tuple[int, int, str]]:
    """Start, end and kind of the records of an MCAP file, or of a ROS 1 bag."""
    if data.startswith(MAGIC):
        return _mcap_records(data)
    spans, position = [(0, 13, "magic")], 13
    while position < len(data):
        head = int.from_bytes(data[position : position + 4], "little")
        body_at = position + 4 + head
        body = int.from_bytes(data[body_at : body_at + 4], "little")
        op = data[position + 4 : body_at].partition(b"op=")[2][:1]
        spans.append((position, body_at + 4 + body, f"op {op.hex()}"))
        position = spans[-1][1]
    return spans


def _mcap_records(data: bytes) -> list[tuple[int, int, str]]:
    spans, position = [(0, len(MAGIC), "magic")], len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = record_head(data, position)
        spans.append((position, position + 9 + length, _KINDS.get(opcode, str(opcode))))
        position = spans[-1][1]
    return [*spans, (position, len(data), "magic at the end")]


def _before(source: Path, place: int) -> int:
    """How many messages a sound reader finds in the records that end at or before `place`."""
    scratch = source.with_name(f"before-{source.name}")
    scratch.write_bytes(source.read_bytes()[:place])
    try:
        return len(records_of(scratch))
    except LogError:
        return 0
    finally:
        scratch.unlink()
