"""Settings of how much a file may claim."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count


@dataclass(frozen=True, slots=True)
class LimitsConfig:
    """What files may claim."""

    chunk_mb: Count = 256  # MB of one chunk of a log; a chunk that claims more is damage
    image_megapixels: Count = 64  # million pixels of one image; one that claims more is damage
    unpacked_gb: Count = 64  # GB that a compressed log may unpack to
