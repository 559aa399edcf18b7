"""One camera's messages while the log streams: colour paired with depth, placed by the odometry."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.rigid import between
from mapmyworld.sensing.grey_images import eight_bits
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.plan import CameraSource
from mapmyworld.types import ImageMessage, RawMessage, RgbdImage


@dataclass(frozen=True, slots=True, eq=False)
class Pending:
    """A message that waits for its frame, and the time it stands for."""

    raw: RawMessage
    stamp_ns: int


@dataclass(slots=True, eq=False)
class CameraQueue:
    """Colour and depth images that no frame has asked for yet."""

    source: CameraSource
    motion: RecordedMotion | None
    config: SensingConfig
    colour: deque[Pending] = field(default_factory=deque)
    depth: deque[Pending] = field(default_factory=deque)

    def add(self, pending: Pending, *, with_colour: bool) -> bool:
        """Takes the message if it is this camera's; colour only where no frame begins with it."""
        topic = pending.raw.topic
        if with_colour and topic == self.source.colour_topic:
            self.colour.append(pending)
        elif topic == self.source.depth_topic:
            self.depth.append(pending)
        else:
            return False
        return True

    def forget_strays(self, before_ns: int) -> None:
        """Images recorded before this log time: what they belong to has not come."""
        for waiting in (self.colour, self.depth):
            while waiting and waiting[0].raw.log_time_ns < before_ns:
                waiting.popleft()

    def take_near(self, stamp_ns: int) -> Pending | None:
        """The colour image nearest to a moment, if it is near enough; it is used up."""
        tolerance_ns = int(self.config.frame_tolerance * 1e9)
        _forget(self.colour, stamp_ns - tolerance_ns)
        nearest = min(self.colour, key=lambda c: abs(c.stamp_ns - stamp_ns), default=None)
        if nearest is None or abs(nearest.stamp_ns - stamp_ns) > tolerance_ns:
            return None
        self.colour.remove(nearest)
        return nearest

    def pair(self, colour: Pending, frame_ns: int) -> RgbdImage | None:
        """Colour with the nearest depth; None when there is none within the tolerance."""
        tolerance_ns = int(self.config.image_tolerance * 1e9)
        _forget(self.depth, colour.stamp_ns - 4 * tolerance_ns)
        depth = min(self.depth, key=lambda d: abs(d.stamp_ns - colour.stamp_ns), default=None)
        if depth is None or abs(depth.stamp_ns - colour.stamp_ns) > tolerance_ns:
            return None
        colour_message, depth_message = self._picture(colour), depth.raw.decode()
        assert isinstance(depth_message, ImageMessage)
        model = self.source.model
        moved = self._moved(frame_ns, colour.stamp_ns)
        if moved is not None:
            model = replace(model, base_from_camera=moved @ model.base_from_camera)
        return RgbdImage(model, colour_message, depth_message)

    def alone(self, colour: Pending) -> RgbdImage:
        """Colour without depth: enough to see known points, not to learn new ones."""
        return RgbdImage(self.source.model, self._picture(colour), None)

    def _picture(self, colour: Pending) -> ImageMessage:
        message = colour.raw.decode()
        assert isinstance(message, ImageMessage)
        if message.stamp_ns != colour.stamp_ns:
            message = replace(message, stamp_ns=colour.stamp_ns)
        bits = self.source.grey_bits
        return eight_bits(message, bits) if bits else message

    def _moved(self, from_ns: int, to_ns: int) -> NDArray[np.float64] | None:
        """Pose (4, 4) of the base at one stamp in the base at another, by the odometry."""
        if self.motion is None or from_ns == to_ns:
            return None
        poses = self.motion.at_many(np.array(sorted((from_ns, to_ns)), np.int64))
        if poses is None:
            return None
        return between(poses[0], poses[1]) if from_ns < to_ns else between(poses[1], poses[0])


def _forget(waiting: deque[Pending], before_ns: int) -> None:
    while waiting and waiting[0].stamp_ns < before_ns:
        waiting.popleft()
