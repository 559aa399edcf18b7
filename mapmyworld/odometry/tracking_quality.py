"""Tracking quality of a camera: when it lost track, and how certain its poses are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mapmyworld.odometry.tracking_losses import NAMED
from mapmyworld.odometry.unobserved_motion import GOES_ON
from mapmyworld.odometry.visual_odometry import VisualMotion

_OPEN = 0.05  # m that images leave open from which on it is worth a word


@dataclass(frozen=True, slots=True)
class BlindPeriod:
    """A run of frames in which the camera was blind, some seeing ones between them forgiven."""

    start_ns: int
    end_ns: int
    frames: int
    why: str

    def text(self) -> str:
        """When, for how long and why."""
        start, seconds = self.start_ns * 1e-9, (self.end_ns - self.start_ns) * 1e-9
        return f"lost at {start:.2f} s for {seconds:.1f} s ({self.frames} frames): {self.why}"


class TrackingQuality:
    """Collects what each frame indicates about itself. State: periods so far, and counts."""

    def __init__(self) -> None:
        self._periods: list[BlindPeriod] = []
        self._frames = self._blind = self._open = 0

    def add(self, stamp_ns: int, motion: VisualMotion) -> None:
        """Takes note of a frame's motion."""
        self._frames += 1
        self._open += motion.sigma_m > _OPEN
        if motion.verdict not in {"dead reckoning", "restarted"}:
            return
        self._blind += 1
        last = self._periods[-1] if self._periods else None
        if last is not None and 1e-9 * (stamp_ns - last.end_ns) <= GOES_ON:
            self._periods[-1] = replace(last, end_ns=stamp_ns, frames=last.frames + 1)
        else:
            why = motion.notes[0] if motion.notes else motion.verdict
            self._periods.append(BlindPeriod(stamp_ns, stamp_ns, 1, why))

    def lines(self) -> tuple[str, ...]:
        """A line for each thing worth knowing; none where the camera saw enough all the time."""
        return (*self._open_lines(), *self._blind_lines(self._periods))

    def _open_lines(self) -> tuple[str, ...]:
        if not self._open:
            return ()
        share = self._open / self._frames
        return (
            f"camera position uncertain by more than {_OPEN:g} m in {self._open} frames "
            f"({share:.1%}): features too few, too far away or in one corner",
        )

    def _blind_lines(self, periods: Sequence[BlindPeriod]) -> tuple[str, ...]:
        if not periods:
            return ()
        share, count = self._blind / self._frames, len(periods)
        head = f"visual tracking lost in {self._blind} frames ({share:.1%}): dead reckoning"
        longest = sorted(periods, key=lambda s: s.start_ns - s.end_ns)[:NAMED]
        named = [s.text() for s in sorted(longest, key=lambda s: s.start_ns)]
        rest = [f"{count - NAMED} shorter losses of visual tracking"] if count > NAMED else []
        return (head, *named, *rest)
