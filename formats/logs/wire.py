"""How ROS 1 and CDR lay values out in bytes: where a string, a header, an array starts and ends.

ROS 1 packs values without gaps. CDR (ROS 2) aligns each to its own size, counted from the end of
its four bytes of encapsulation, and ends strings with a zero.
"""

from __future__ import annotations

from struct import Struct

import numpy as np
from numpy.typing import NDArray

from formats.logs.channels import Payload

_ROS1_HEADER = Struct("<IIII").unpack_from


class Ros1Wire:
    """Little-endian, packed; headers carry a sequence number."""

    start = 0

    def __init__(self, order: str = "<") -> None:
        self.order = order
        self._stamp = Struct(order + "iII").unpack_from
        self._u32 = Struct(order + "I").unpack_from
        self.unpack_pose = Struct(order + "7d").unpack_from  # x y z qx qy qz qw

    def align(self, position: int, size: int) -> int:
        """Where a number of so many bytes begins, at this place or after it."""
        return position

    def header(self, data: Payload, position: int) -> tuple[int, str, int]:
        """Stamp, frame and the position after a std_msgs/Header."""
        _, seconds, nanoseconds, length = _ROS1_HEADER(data, position)
        end = position + 16 + length
        frame = str(data[position + 16 : end], "utf-8")
        return seconds * 1_000_000_000 + nanoseconds, frame, end

    def string(self, data: Payload, position: int) -> tuple[str, int]:
        """Text with its length before it, and the place behind it."""
        length, position = self.u32(data, position)
        _check(data, position, length)
        return str(data[position : position + length], "utf-8"), position + length

    def u32(self, data: Payload, position: int) -> tuple[int, int]:
        """A number of four bytes, and the place behind it."""
        return self._u32(data, position)[0], position + 4

    def octets(self, data: Payload, position: int) -> tuple[bytes, int]:
        """A sequence of bytes."""
        length, position = self.u32(data, position)
        _check(data, position, length)
        return bytes(data[position : position + length]), position + length

    def floats(self, data: Payload, position: int, kind: str) -> tuple[NDArray[np.generic], int]:
        """A sequence of N numbers (N,) of numpy kind "f4" or "f8", and the place after it."""
        length, position = self.u32(data, position)
        return self.array(data, position, kind, length)

    def array(
        self, data: Payload, position: int, kind: str, length: int
    ) -> tuple[NDArray[np.generic], int]:
        """N = `length` numbers (N,), read-only, in native byte order, and the place after them."""
        size = 4 if kind == "f4" else 8
        if length == 0:
            return np.zeros(0, kind), position
        position = self.align(position, size)
        return np.frombuffer(data, "<" + kind, length, position), position + size * length


class CdrWire(Ros1Wire):
    """Aligned; byte order as the encapsulation says."""

    start = 4

    def align(self, position: int, size: int) -> int:
        """Where a number of so many bytes begins, at this place or after it."""
        return position + (4 - position) % size

    def header(self, data: Payload, position: int) -> tuple[int, str, int]:
        position += -position % 4
        seconds, nanoseconds, length = self._stamp(data, position)
        end = position + 12 + length
        frame = str(data[position + 12 : end - 1], "utf-8") if length else ""
        return seconds * 1_000_000_000 + nanoseconds, frame, end

    def string(self, data: Payload, position: int) -> tuple[str, int]:
        """Text with its length before it, and the place behind it."""
        length, position = self.u32(data, position)
        _check(data, position, length)
        return str(data[position : position + max(length - 1, 0)], "utf-8"), position + length

    def u32(self, data: Payload, position: int) -> tuple[int, int]:
        """A number of four bytes, and the place behind it."""
        position += -position % 4
        return self._u32(data, position)[0], position + 4

    def array(
        self, data: Payload, position: int, kind: str, length: int
    ) -> tuple[NDArray[np.generic], int]:
        """N = `length` numbers (N,) of a numpy kind, and the place after them."""
        found, end = super().array(data, position, kind, length)
        if self.order == ">" and length:
            found = np.frombuffer(data, ">" + kind, length, end - found.nbytes).astype(kind)
        return found, end


def _check(data: Payload, position: int, length: int) -> None:
    if position + length > len(data):
        raise ValueError(f"{length} bytes are announced, {len(data) - position} are there")


Wire = Ros1Wire
ROS1 = Ros1Wire()
CDR_LITTLE, CDR_BIG = CdrWire("<"), CdrWire(">")


def cdr_wire(data: Payload) -> CdrWire:
    """The byte order that the message's encapsulation names; ValueError for another encoding."""
    if data[:2] == b"\x00\x01":
        return CDR_LITTLE
    if data[:2] == b"\x00\x00":
        return CDR_BIG
    raise ValueError(f"encapsulation {data[:4].hex()} is not plain CDR")
