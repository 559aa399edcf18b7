"""What values a setting may take, said by its type."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal


@dataclass(frozen=True, slots=True)
class Range:
    """The finite numbers from `least` to `most`; where `is_open`, without these two."""

    least: float = -math.inf
    most: float = math.inf
    is_open: bool = False

    def __contains__(self, value: float) -> bool:
        if self.is_open:
            return self.least < value < self.most
        return math.isfinite(value) and self.least <= value <= self.most

    def __str__(self) -> str:
        if math.isinf(self.least):
            return "a finite number"
        if math.isinf(self.most):
            return f"more than {self.least:g}" if self.is_open else f"{self.least:g} or more"
        ends = "between {:g} and {:g}" if self.is_open else "from {:g} to {:g}"
        return ends.format(self.least, self.most)


Positive = Annotated[float, Range(0.0, is_open=True)]
FromZero = Annotated[float, Range(0.0)]
Shift = Annotated[float, Range(-1e9, 1e9)]  # s; what 64 bits of nanoseconds hold, and to spare
Share = Annotated[float, Range(0.0, 1.0)]
Unlikely = Annotated[float, Range(0.0, 0.5, is_open=True)]
Likely = Annotated[float, Range(0.5, 1.0, is_open=True)]
Probability = Annotated[float, Range(0.0, 1.0, is_open=True)]
Step = Annotated[float, Range(0.01, 1e6)]
Quality = Annotated[int, Range(1, 100)]
Count = Annotated[int, Range(1)]
Whole = Annotated[int, Range(0)]
Seed = Annotated[int, Range(0, 2**64 - 1)]
Many = Annotated[int, Range(1, 1_000_000)]
Grey = Annotated[int, Range(1, 255)]
ImageCodec = Literal["jpeg", "png"]
DepthCodec = Literal["png", "float"]
