"""Frames: what the sensors indicate about one moment, matched by stamp while the log streams."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry.rotations import quaternion_to_rotation, rotation_to_quaternion
from mapmyworld.sensing.camera_queue import CameraQueue, Pending
from mapmyworld.sensing.cloud_scans import points_of_cloud, scan_of_points
from mapmyworld.sensing.gps_fixes import GpsFixes
from mapmyworld.sensing.order import in_stamp_order
from mapmyworld.sensing.plan import Plan
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.types import (
    Frame,
    ImuMessage,
    ImuSample,
    LaserScanMessage,
    LogSource,
    PointCloudMessage,
    PoseMessage,
    RawMessage,
    RgbdImage,
    Scan,
)

_WAIT_NS = 500_000_000  # log time by which a late sensor's message must have come
_KEPT_NS = 4 * _WAIT_NS  # log time for which messages wait for the frame they belong to
_MOST_MEASURED = 1e6  # rad/s or m/s^2
_MOST_SAMPLES = 1 << 14  # inertial samples and true poses that wait where no frame comes


@dataclass(slots=True)
class FrameCounts:
    """What became of the messages; filled while frames are read."""

    frames: int = 0
    undecodable: int = 0
    without_odometry: int = 0
    unpaired_images: int = 0
    repeated: int = 0
    """Messages of the very stamp of the one before: the same one, recorded twice."""
    unusable: int = 0
    """Inertial samples, true poses and images beside a scan that cannot be decoded."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the main sensor, and the camera beside it, show at one moment."""

    scan: Scan | None = None
    cloud: NDArray[np.float32] | None = None
    """(N, 3) in the base frame."""
    image: RgbdImage | None = None


@dataclass(slots=True)
class _Buffers:
    main: deque[Pending] = field(default_factory=deque)
    imu: deque[ImuSample] = field(default_factory=lambda: deque(maxlen=_MOST_SAMPLES))
    truth: deque[PoseMessage] = field(default_factory=lambda: deque(maxlen=_MOST_SAMPLES))


def read_frames(
    log: LogSource,
    plan: Plan,
    config: SensingConfig,
    counts: FrameCounts | None = None,
    watch: Callable[[int], None] | None = None,
    *,
    inertial: bool = True,
) -> Iterator[Frame]:
    """The frames of a log in its order: one for each scan, or for each image without a laser.

    `counts` holds afterwards what was left out; `watch` gets the log time reached. Without
    `inertial` no inertial sample is read, and frames have none.
    """
    counts = counts if counts is not None else FrameCounts()
    synchroniser = _Synchroniser(plan, config, counts)
    unread = plan.imu.topic if plan.imu and not inertial else None
    messages = log.messages([topic for topic in plan.topics if topic != unread])
    for raw in in_stamp_order(messages, plan.sort_ns) if plan.sort_ns else messages:
        synchroniser.add(raw)
        yield from synchroniser.ready(raw.log_time_ns - _WAIT_NS)
        if watch is not None:
            watch(raw.log_time_ns)
    yield from synchroniser.ready(None)


class _Synchroniser:
    def __init__(self, plan: Plan, config: SensingConfig, counts: FrameCounts) -> None:
        self.plan, self.config, self.counts = plan, config, counts
        self.buffers = _Buffers()
        self.gps = GpsFixes()
        motion = plan.odometry.motion if plan.odometry else None
        sources = [s for s in (plan.camera, *plan.more_cameras) if s is not None]
        self.cameras = [CameraQueue(source, motion, config) for source in sources]
        self.offsets_ns = _offsets_ns(plan, config)
        self.last_ns: int | None = None
        self.main_topic = plan.scan.topic if plan.scan else ""
        if plan.scan is None and plan.camera is not None:
            self.main_topic = plan.camera.colour_topic

    def add(self, raw: RawMessage) -> None:
        stamp = raw.log_time_ns if self.plan.use_log_time else raw.stamp_ns
        stamp = raw.log_time_ns if stamp is None else stamp
        pending = Pending(raw, stamp + self.offsets_ns.get(raw.topic, 0))
        is_main = raw.topic == self.main_topic
        if is_main:
            self.buffers.main.append(pending)
        taken = [c.add(pending, with_colour=not is_main) for c in self.cameras]
        if not (is_main or any(taken)):
            self._add_other(pending)
        self._forget_strays(raw.log_time_ns)

    def _add_other(self, pending: Pending) -> None:
        topic = pending.raw.topic
        if self.plan.imu is not None and topic == self.plan.imu.topic:
            self._add_imu(pending)
        elif topic == self.plan.ground_truth_topic:
            self._add_truth(pending.raw)
        elif topic == self.plan.gps_topic:
            self.gps.add(pending.raw)

    def _forget_strays(self, now_ns: int) -> None:
        """Images that no frame has asked for in time: the scans may have stopped for good."""
        main = self.buffers.main
        before_ns = (main[0].raw.log_time_ns if main else now_ns) - _KEPT_NS
        for camera in self.cameras:
            camera.forget_strays(before_ns)

    def ready(self, before_log_ns: int | None) -> Iterator[Frame]:
        """Frames whose other messages must have come by now; all when the log has ended."""
        main = self.buffers.main
        while main and (before_log_ns is None or main[0].raw.log_time_ns <= before_log_ns):
            pending = main.popleft()
            if pending.stamp_ns == self.last_ns and not self.plan.use_log_time:
                self.counts.repeated += 1
                continue
            self.last_ns = pending.stamp_ns
            frame = self._frame(pending)
            if frame is not None:
                self.counts.frames += 1
                yield frame

    def _frame(self, main: Pending) -> Frame | None:
        try:
            seen = self._observations(main)
        except LogError:
            self.counts.undecodable += 1
            return None
        if seen.scan is None and seen.image is None:
            self.counts.unpaired_images += 1
            return None
        images = [seen.image, *(self._image_near(c, main.stamp_ns) for c in self.cameras[1:])]
        odometry = self.plan.odometry
        pose = odometry.motion.at(main.stamp_ns) if odometry else None
        if odometry is not None and pose is None:
            self.counts.without_odometry += 1
        return Frame(
            stamp_ns=main.stamp_ns,
            odom_from_base=pose,
            scan=seen.scan,
            images=tuple(found for found in images if found is not None),
            cloud=seen.cloud,
            imu=self._imu_until(main.stamp_ns),
            ground_truth=self._truth_at(main.stamp_ns),
            gps=self.gps.fix_at(main.stamp_ns),
            is_interpolated=bool(odometry and odometry.motion.is_interpolated(main.stamp_ns)),
        )

    def _observations(self, main: Pending) -> _Seen:
        if self.plan.scan is None:
            return _Seen(image=self._main_image(main))
        seen = self._by_lidar(main, self.plan.scan.base_from_lidar)
        near = [self._image_near(c, main.stamp_ns) for c in self.cameras[:1]]
        return replace(seen, image=near[0] if near else None)

    def _by_lidar(self, main: Pending, base_from_lidar: NDArray[np.float64]) -> _Seen:
        """The sweep, and all points of a 3D lidar."""
        message = main.raw.decode()
        if isinstance(message, PointCloudMessage):
            points = points_of_cloud(message, base_from_lidar, self.config)
            scan = scan_of_points(points, base_from_lidar, self.config)
            return _Seen(scan, points.astype(np.float32))
        assert isinstance(message, LaserScanMessage)
        odometry = self.plan.odometry
        if message.stamp_ns != main.stamp_ns:
            message = replace(message, stamp_ns=main.stamp_ns)
        motion = odometry.motion if odometry else None
        return _Seen(scan_from_message(message, base_from_lidar, motion))

    def _main_image(self, main: Pending) -> RgbdImage | None:
        """The image that a frame begins with; colour alone where only images measure the motion."""
        image = self.cameras[0].pair(main, main.stamp_ns)
        if image is None and self.plan.odometry is None:
            self.counts.unpaired_images += 1
            return self.cameras[0].alone(main)
        return image

    def _image_near(self, camera: CameraQueue, stamp_ns: int) -> RgbdImage | None:
        """A camera's image nearest to a frame, with the motion between them."""
        nearest = camera.take_near(stamp_ns)
        try:
            return None if nearest is None else camera.pair(nearest, stamp_ns)
        except LogError:  # the rest of the frame is sound
            self.counts.unusable += 1
            return None

    def _add_imu(self, pending: Pending) -> None:
        assert self.plan.imu is not None
        try:
            message = pending.raw.decode()
        except LogError:
            self.counts.unusable += 1
            return
        assert isinstance(message, ImuMessage)
        if not _is_sound(message):
            self.counts.unusable += 1
            return
        rotation = self.plan.imu.base_from_imu[:3, :3]
        orientation = message.orientation
        if orientation is not None:
            turned = quaternion_to_rotation(orientation) @ rotation.T
            orientation = rotation_to_quaternion(turned)
        self.buffers.imu.append(
            ImuSample(
                pending.stamp_ns,
                rotation @ message.angular_velocity,
                rotation @ message.linear_acceleration,
                orientation,
            )
        )

    def _imu_until(self, stamp_ns: int) -> tuple[ImuSample, ...]:
        samples = []
        while self.buffers.imu and self.buffers.imu[0].stamp_ns <= stamp_ns:
            samples.append(self.buffers.imu.popleft())
        return tuple(samples)

    def _add_truth(self, raw: RawMessage) -> None:
        try:
            message = raw.decode()
        except LogError:
            self.counts.unusable += 1
            return
        assert isinstance(message, PoseMessage)
        self.buffers.truth.append(message)

    def _truth_at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """The true pose nearest to a stamp, within the tolerance of a frame."""
        truths = self.buffers.truth
        tolerance_ns = int(self.config.frame_tolerance * 1e9)
        while truths and truths[0].stamp_ns < stamp_ns - tolerance_ns:
            truths.popleft()
        nearest = min(truths, key=lambda t: abs(t.stamp_ns - stamp_ns), default=None)
        if nearest is None or abs(nearest.stamp_ns - stamp_ns) > tolerance_ns:
            return None
        return nearest.pose


def _offsets_ns(plan: Plan, config: SensingConfig) -> dict[str, int]:
    """Topic -> what the settings add to its stamps; the odometry's stand in its motion."""
    cameras = [c for c in (plan.camera, *plan.more_cameras) if c is not None]
    images = [topic for c in cameras for topic in (c.colour_topic, c.depth_topic)]
    seconds = dict.fromkeys(images, config.camera_offset)
    if plan.scan is not None:
        seconds[plan.scan.topic] = config.scan_offset
    if plan.imu is not None:
        seconds[plan.imu.topic] = config.imu_offset
    return {topic: round(s * 1e9) for topic, s in seconds.items() if s}


def _is_sound(message: ImuMessage) -> bool:
    """Whether an inertial message says what such a sensor can measure."""
    measured = message.angular_velocity.tolist() + message.linear_acceleration.tolist()
    if not all(-_MOST_MEASURED < value < _MOST_MEASURED for value in measured):  # nor NaN
        return False
    if message.orientation is None:
        return True
    turn = message.orientation.tolist()
    return all(-2.0 < part < 2.0 for part in turn) and math.hypot(*turn) > 0.5
