"""How much a file may claim, whatever it says: what decompressors and readers stop at."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """What a file may claim at most; more is damage."""

    chunk_bytes: int = 256 << 20
    """Of a chunk of a log, compressed or not."""
    image_pixels: int = 64_000_000
    unpacked_bytes: int = 64 << 30
    """That a compressed log may unpack to."""


class _InForce:
    limits = Limits()


def limits() -> Limits:
    """Those in force."""
    return _InForce.limits


def set_limits(new: Limits) -> None:
    """Sets them for the whole process, before files are opened: readers work on many threads."""
    _InForce.limits = new
