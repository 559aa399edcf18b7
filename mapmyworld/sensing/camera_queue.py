"""One camera's messages while the log streams: colour paired with depth, placed by the odometry."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.rigid import between
from mapmyworld.sensing.grey_images import eight_bits
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.plan import CameraSource
from mapmyworld.types import ImageMessage, PoseMessage, RawMessage, RgbdImage

_KEPT = 4  # tolerances for which what is past waits: stamps may step back a little


@dataclass(frozen=True, slots=True, eq=False)
class Pending:
    """A message that waits for its frame, and the time it stands for."""

    raw: RawMessage
    stamp_ns: int


Stamped = TypeVar("Stamped", Pending, PoseMessage)


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
        found = nearest(self.colour, stamp_ns, self.config.frame_tolerance)
        if found is not None:
            self.colour.remove(found)
        return found

    def pair(self, colour: Pending, frame_ns: int) -> RgbdImage | None:
        """Colour with the nearest depth; None when there is none within the tolerance."""
        depth = nearest(self.depth, colour.stamp_ns, self.config.image_tolerance)
        if depth is None:
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
        poses = self.motion.at_many(np.array([from_ns, to_ns], np.int64))
        return None if poses is None else between(poses[0], poses[1])


def nearest(waiting: deque[Stamped], stamp_ns: int, tolerance_s: float) -> Stamped | None:
    """What waits with the stamp nearest to this one, if it is near enough; long past is dropped."""
    tolerance_ns = int(tolerance_s * 1e9)
    while waiting and waiting[0].stamp_ns < stamp_ns - _KEPT * tolerance_ns:
        waiting.popleft()
    found = min(waiting, key=lambda one: abs(one.stamp_ns - stamp_ns), default=None)
    near = found is not None and abs(found.stamp_ns - stamp_ns) <= tolerance_ns
    return found if near else None
