"""A recorded motion as compact arrays, looked up by stamp."""

from __future__ import annotations

from array import array
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import transforms_of_rows

FARTHEST = 1e9  # m from the origin beyond which a pose is no place on earth
_FARTHEST_NS = 500_000_000  # from the nearest sample at which a pose is known
COURSE = 0.5
"""Seconds either way of a stamp: a robot keeps its course as long, and few stamps err by more."""
_NEARBY = 64  # samples around the last look-up that are searched in an unsorted stream


def is_place(pose: NDArray[np.float64]) -> bool:
    """Whether a pose (4, 4) is finite and on earth."""
    values = pose[:3].ravel().tolist()
    # Of a dozen numbers a tenth of numpy's time; a sum with NaN is no number's neighbour.
    return max(values) < FARTHEST and min(values) > -FARTHEST and abs(sum(values)) < 12 * FARTHEST


class MotionRecorder:
    """Collects poses in the order in which they come; 112 bytes a sample."""

    def __init__(self) -> None:
        self._stamps, self._log_times = array("q"), array("q")
        self._values = array("d")

    def add(self, stamp_ns: int, pose: NDArray[np.float64], log_time_ns: int | None = None) -> bool:
        """One more pose (4, 4), in the order of the log; False, and left out, if it is no place.

        Its log time is its stamp unless told.
        """
        if not is_place(pose):
            return False
        self._stamps.append(stamp_ns)
        self._log_times.append(stamp_ns if log_time_ns is None else log_time_ns)
        self._values.extend(pose[:3].ravel().tolist())
        return True

    def finish(self) -> RecordedMotion:
        """The motion, in the very memory in which it was collected: nothing can be added then."""
        return RecordedMotion(
            np.frombuffer(self._stamps, np.int64),
            np.frombuffer(self._values).reshape(-1, 3, 4),
            log_times_ns=np.frombuffer(self._log_times, np.int64),
        )


class RecordedMotion:
    """Poses over time, in the order of the log, which need not be the order of the stamps.

    Where the stamps step back (a recorder that wrote late stamps), the order of the log is the
    order of motion, so a look-up searches only near the one before it.
    """

    def __init__(
        self,
        stamps_ns: NDArray[np.int64],
        values: NDArray[np.float64],
        interpolated: NDArray[np.bool_] | None = None,
        log_times_ns: NDArray[np.int64] | None = None,
    ) -> None:
        """`values` (N, 3, 4) are the upper rows of the poses at `stamps_ns` (N,); `interpolated`
        (N,) those that nobody measured; `log_times_ns` (N,) when they were recorded.
        """
        self.stamps_ns = stamps_ns
        self._log_times_ns = stamps_ns if log_times_ns is None else log_times_ns
        nowhere = np.zeros(len(stamps_ns), np.bool_)
        self._interpolated = nowhere if interpolated is None else interpolated
        self._values = np.ascontiguousarray(values)
        self.is_sorted = bool(np.all(np.diff(stamps_ns) >= 0)) if len(stamps_ns) else True
        self._last = 0

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def followed_by(self, child_from_base: NDArray[np.float64]) -> RecordedMotion:
        """The same motion of another frame, fixed to the recorded one: `child_from_base` (4, 4)."""
        poses = self.poses_at(slice(None)) @ child_from_base
        return self.with_poses(poses, np.zeros(len(poses), np.bool_))

    def with_poses(
        self, poses: NDArray[np.float64], interpolated: NDArray[np.bool_]
    ) -> RecordedMotion:
        """Other poses (N, 4, 4) at the same times; `interpolated` (N,) more that are no measure."""
        return RecordedMotion(
            self.stamps_ns, poses[:, :3], self._interpolated | interpolated, self._log_times_ns
        )

    def on_log_time(self) -> RecordedMotion:
        """The same poses stamped by when they were recorded: where header stamps are of no use."""
        return RecordedMotion(self._log_times_ns, self._values, self._interpolated)

    def in_stamp_order(self) -> RecordedMotion:
        """The same poses sorted by stamp."""
        order = np.argsort(self.stamps_ns, kind="stable")
        stamps_ns, values = self.stamps_ns[order], self._values[order]
        log_times_ns = self._log_times_ns[order]
        return RecordedMotion(stamps_ns, values, self._interpolated[order], log_times_ns)

    def shifted(self, seconds: float) -> RecordedMotion:
        """The same poses with so much added to their stamps."""
        return RecordedMotion(
            self.stamps_ns + round(seconds * 1e9),
            self._values,
            self._interpolated,
            self._log_times_ns,
        )

    def is_interpolated(self, stamp_ns: int) -> bool:
        """Whether the pose there follows from others that were measured (sorted stamps only)."""
        if not self._has_interpolated:
            return False
        before = max(int(self.stamps_ns.searchsorted(stamp_ns, "right")) - 1, 0)
        after = min(int(self.stamps_ns.searchsorted(stamp_ns, "left")), len(self) - 1)
        return bool(self._interpolated[before] or self._interpolated[after])

    @cached_property
    def _has_interpolated(self) -> bool:
        return bool(self._interpolated.any())

    @cached_property
    def moves(self) -> bool:
        """Whether two of its poses differ."""
        return bool((self._values != self._values[:1]).any())

    def distance(self) -> float:
        """Metres from pose to pose, in the order in which they are."""
        return float(np.linalg.norm(np.diff(self._values[:, :, 3], axis=0), axis=1).sum())

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """The pose (4, 4) at a stamp, interpolated; the end pose just outside the record.

        None where the nearest sample is further than half a second away.
        """
        exact = self._samples_at(stamp_ns)
        if len(exact):
            nearest = np.abs(exact - self._last).argmin() if len(exact) > 1 else 0
            self._last = int(exact[nearest])
            return np.asarray(transforms_of_rows(self._values[self._last])[0])
        found = self.at_many(np.array([stamp_ns], np.int64))
        return None if found is None else found[0]

    def in_plane(self, stamps_ns: NDArray[np.int64]) -> Array:
        """x, y and heading, unwrapped, (N, 3) at stamps (N,); the end poses outside the record."""
        from mapmyworld.kernels.recorded_motion import interpolated_rows

        found = np.empty((len(stamps_ns), 3))
        interpolated_rows(self._by_stamp[1], self._rows, stamps_ns, found)
        return found

    def velocity(self, stamp_ns: int) -> Array:
        """(3,) m/s and rad/s in the plane, in the base frame: the mean of `COURSE` either way."""
        around = round(COURSE * 1e9) * np.array([-1, 0, 1])
        before, now, after = self.in_plane(stamp_ns + around)
        (x, y, turned), (c, s) = after - before, (np.cos(now[2]), np.sin(now[2]))
        return np.array([c * x + s * y, c * y - s * x, turned]) / (2.0 * COURSE)

    @cached_property
    def _rows(self) -> Array:
        """(N, 3) x, y and heading, unwrapped, in the order of the stamps."""
        rows = self._values[self._by_stamp[0]]
        heading = np.unwrap(np.arctan2(rows[:, 1, 0], rows[:, 0, 0]))
        return np.stack([rows[:, 0, 3], rows[:, 1, 3], heading], axis=-1)

    def at_many(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Poses (N, 4, 4) at stamps (N,) close to one another; None unless all are covered."""
        from mapmyworld.kernels.recorded_motion import interpolated_poses

        if not len(self):
            return None
        samples = slice(None) if self.is_sorted else self._window(int(stamps_ns[0]))
        stamps, values = self.stamps_ns[samples], self._values[samples]
        found = np.empty((len(stamps_ns), 4, 4))
        return found if interpolated_poses(stamps, values, stamps_ns, _FARTHEST_NS, found) else None

    def poses_at(self, indices: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Poses (N, 4, 4) of samples `indices` (N,), counted in the order of the log."""
        return transforms_of_rows(self._values[indices])

    def _samples_at(self, stamp_ns: int) -> NDArray[np.int64]:
        """Indices of the samples with this very stamp, in the order of the log."""
        order, stamps = self._by_stamp
        return order[slice(*stamps.searchsorted([stamp_ns, stamp_ns + 1]))]

    @cached_property
    def _by_stamp(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """What sorts the samples by stamp, those of one stamp in the order of the log; stamps so.

        For streams that are unsorted: every look-up would else read all of it.
        """
        order = np.argsort(self.stamps_ns, kind="stable")
        return order, self.stamps_ns[order]

    def _window(self, stamp_ns: int) -> NDArray[np.int64]:
        """Samples around where `stamp_ns` lies, nearest to the last look-up, sorted by stamp."""
        exact = self._samples_at(stamp_ns)
        if len(exact):
            centre = int(exact[np.argmin(np.abs(exact - self._last))])
        else:
            low = max(self._last - 16 * _NEARBY, 0)
            near = self.stamps_ns[low : self._last + 16 * _NEARBY]
            centre = low + int(np.argmin(np.abs(near - stamp_ns)))
        self._last = centre
        window = np.arange(max(centre - _NEARBY, 0), min(centre + _NEARBY + 1, len(self)))
        return window[np.argsort(self.stamps_ns[window], kind="stable")]
