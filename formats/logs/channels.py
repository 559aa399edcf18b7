"""What containers of serialised messages give: channels, and records on them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One stream of messages of one type."""

    topic: str
    type_name: str
    """As ROS 2 writes it ("sensor_msgs/msg/LaserScan"), or "foxglove.LaserScan"."""
    encoding: str
    """Of the messages: "ros1", "cdr", "protobuf", "json", or another that we do not decode."""
    schema_encoding: str = ""
    """Of the definition: "ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema" or none."""
    schema: bytes = b""
    digest: str = ""
    """MD5 of a ROS 1 type, RIHS01 hash of a ROS 2 type, where recorded."""
    latching: bool = False
    """Messages hold until replaced: ROS 1 latching, ROS 2 transient local."""
    metadata: Mapping[str, str] = field(default_factory=dict)


Record = tuple[int, Channel, bytes]
"""Log time in nanoseconds, channel, payload."""

Found = tuple[int, int, bytes]
"""The same with the channel's id in the file."""


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of the file that is read at once: a chunk, or a run of messages outside of any."""

    offset: int
    """Its first byte, or the number of its first row."""
    length: int
    """In bytes, or rows."""
    start_ns: int
    end_ns: int
    channels: frozenset[int]
    """Ids of the channels that speak in it."""


@dataclass(slots=True)
class Index:
    """What a file holds and where, from reading it through."""

    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    spans: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Times of each channel's first and last message, in ns."""
    blocks: list[Block] = field(default_factory=list)
    details: list[tuple[str, str]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    """What was found damaged."""

    def add(self, messages: Sequence[Found], offset: int, length: int) -> None:
        """A block by the messages found in it; none where there are none."""
        if messages:
            found = defaultdict[int, list[int]](list)
            for time, key, _ in messages:
                found[key].append(time)
            for key, times in found.items():
                self.counts[key] = self.counts.get(key, 0) + len(times)
                times += self.spans.get(key, ())
                self.spans[key] = min(times), max(times)
            every = [time for time, _, _ in messages]
            self.blocks.append(Block(offset, length, min(every), max(every), frozenset(found)))


def normalised_type(name: str) -> str:
    """ROS 1's two-part type names as ROS 2 writes them; others as they are."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name
