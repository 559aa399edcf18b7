"""Frames: what the sensors indicate about one moment, matched by stamp while the log streams."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.sensing.camera_queue import CameraQueue, Pending, nearest
from mapmyworld.sensing.cloud_scans import points_of_cloud, scan_of_points
from mapmyworld.sensing.order import in_stamp_order
from mapmyworld.sensing.plan import Plan, ScanSource
from mapmyworld.sensing.sweeps import scan_from_message
from mapmyworld.types import (
    Frame,
    GpsMessage,
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
_FIX_NS = 1_000_000_000  # after which a fix indicates nothing about where the robot is
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
    """Inertial samples, true poses, fixes and images beside a scan that cannot be decoded."""


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


def scans_near(
    log: LogSource,
    plan: Plan,
    stamps_ns: NDArray[np.int64],
    config: SensingConfig,
    watch: Callable[[int], None],
) -> list[LaserScanMessage | None]:
    """Of each stamp (N,) the scan nearest to it, with the stamp that the plan gives it.

    None where that cannot be decoded; `watch` gets the log time reached.
    """
    assert plan.scan is not None
    topic = plan.scan.topic
    offset_ns = _offsets_ns(plan, config).get(topic, 0)
    wanted, rows = np.unique(stamps_ns, return_inverse=True)
    nearest = dict[int, tuple[int, RawMessage, int]]()
    for raw in log.messages([topic]):
        stamp_ns = _stamp_ns(raw, plan) + offset_ns
        after = int(wanted.searchsorted(stamp_ns))
        for k in range(max(after - 1, 0), min(after + 1, len(wanted))):
            apart = abs(stamp_ns - int(wanted[k]))
            if k not in nearest or apart < nearest[k][0]:
                nearest[k] = apart, raw, stamp_ns
        watch(raw.log_time_ns)
    found = dict[int, LaserScanMessage]()
    for k, (_, raw, stamp_ns) in nearest.items():
        with contextlib.suppress(LogError):
            message = raw.decode()
            if isinstance(message, LaserScanMessage):
                found[k] = replace(message, stamp_ns=stamp_ns)
    return [found.get(k) for k in rows.tolist()]


def _stamp_ns(raw: RawMessage, plan: Plan) -> int:
    """When a message was taken, by its header where the plan believes it and it has one."""
    stamped = None if plan.use_log_time else raw.stamp_ns
    return raw.log_time_ns if stamped is None else stamped


class _Synchroniser:
    def __init__(self, plan: Plan, config: SensingConfig, counts: FrameCounts) -> None:
        self.plan, self.config, self.counts = plan, config, counts
        self.main: deque[Pending] = deque()
        self.imu: deque[ImuSample] = deque(maxlen=_MOST_SAMPLES)
        self.truth: deque[PoseMessage] = deque(maxlen=_MOST_SAMPLES)
        self.fix: GpsMessage | None = None
        motion = plan.odometry.motion if plan.odometry else None
        sources = [s for s in (plan.camera, *plan.more_cameras) if s is not None]
        self.cameras = [CameraQueue(source, motion, config) for source in sources]
        self.offsets_ns = _offsets_ns(plan, config)
        self.last_ns: int | None = None
        self.main_topic = plan.scan.topic if plan.scan else ""
        if plan.scan is None and plan.camera is not None:
            self.main_topic = plan.camera.colour_topic

    def add(self, raw: RawMessage) -> None:
        pending = Pending(raw, _stamp_ns(raw, self.plan) + self.offsets_ns.get(raw.topic, 0))
        is_main = raw.topic == self.main_topic
        if is_main:
            self.main.append(pending)
        taken = [c.add(pending, with_colour=not is_main) for c in self.cameras]
        if not (is_main or any(taken)):
            self._add_other(pending)
        # Images that no frame has asked for in time: the scans may have stopped for good.
        first_ns = self.main[0].raw.log_time_ns if self.main else raw.log_time_ns
        for camera in self.cameras:
            camera.forget_strays(first_ns - _KEPT_NS)

    def _add_other(self, pending: Pending) -> None:
        """Takes an inertial sample, a true pose or a fix; one that is damaged is counted."""
        try:
            message = pending.raw.decode()
        except LogError:
            self.counts.unusable += 1
            return
        if isinstance(message, PoseMessage):
            self.truth.append(message)
        elif isinstance(message, GpsMessage):
            if math.isfinite(message.latitude + message.longitude):
                self.fix = message
        elif isinstance(message, ImuMessage) and self.plan.imu is not None:
            self._add_imu(message, pending.stamp_ns, self.plan.imu.base_from_imu[:3, :3])

    def ready(self, before_log_ns: int | None) -> Iterator[Frame]:
        """Frames whose other messages must have come by now; all when the log has ended."""
        main = self.main
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
        scan, cloud, image, odometry = None, None, None, self.plan.odometry
        try:
            if self.plan.scan is None:
                image = self._main_image(main)
            else:
                scan, cloud = self._by_lidar(main, self.plan.scan)
        except LogError:
            self.counts.undecodable += 1
            return None
        if scan is None and image is None:
            self.counts.unpaired_images += 1
            return None
        others = self.cameras[1:] if scan is None else self.cameras
        imu = list[ImuSample]()
        while self.imu and self.imu[0].stamp_ns <= main.stamp_ns:
            imu.append(self.imu.popleft())
        images = [image, *(self._image_near(camera, main.stamp_ns) for camera in others)]
        pose = odometry.motion.at(main.stamp_ns) if odometry else None
        if odometry is not None and pose is None:
            self.counts.without_odometry += 1
        truth, fix = nearest(self.truth, main.stamp_ns, self.config.frame_tolerance), self.fix
        return Frame(
            stamp_ns=main.stamp_ns,
            odom_from_base=pose,
            scan=scan,
            images=tuple(found for found in images if found is not None),
            cloud=cloud,
            imu=tuple(imu),
            ground_truth=None if truth is None else truth.pose,
            gps=fix if fix is not None and abs(main.stamp_ns - fix.stamp_ns) <= _FIX_NS else None,
            is_interpolated=bool(odometry and odometry.motion.is_interpolated(main.stamp_ns)),
        )

    def _by_lidar(
        self, main: Pending, source: ScanSource
    ) -> tuple[Scan, NDArray[np.float32] | None]:
        """The sweep, and all points (N, 3) of a 3D lidar in the base frame."""
        message = main.raw.decode()
        if isinstance(message, PointCloudMessage):
            points = points_of_cloud(message, source.base_from_lidar, self.config)
            scan = scan_of_points(points, source.base_from_lidar, self.config)
            return scan, points.astype(np.float32)
        assert isinstance(message, LaserScanMessage)
        odometry = self.plan.odometry
        if message.stamp_ns != main.stamp_ns:
            message = replace(message, stamp_ns=main.stamp_ns)
        motion = odometry.motion if odometry else self.plan.sweep_motion
        motion = motion if source.is_deskewed else None
        scan = scan_from_message(message, source.base_from_lidar, motion, source.seconds_a_radian)
        return scan, None

    def _main_image(self, main: Pending) -> RgbdImage | None:
        """The image that a frame begins with; colour alone where only images measure the motion."""
        image = self.cameras[0].pair(main, main.stamp_ns)
        if image is None and self.plan.odometry is None:
            self.counts.unpaired_images += 1
            return self.cameras[0].alone(main)
        return image

    def _image_near(self, camera: CameraQueue, stamp_ns: int) -> RgbdImage | None:
        """A camera's image nearest to a frame, with the motion between them."""
        colour = camera.take_near(stamp_ns)
        try:
            return None if colour is None else camera.pair(colour, stamp_ns)
        except LogError:  # the rest of the frame is sound
            self.counts.unusable += 1
            return None

    def _add_imu(self, message: ImuMessage, stamp_ns: int, rotation: NDArray[np.float64]) -> None:
        turning, force = message.angular_velocity, message.linear_acceleration
        if (np.abs([*turning, *force]) < _MOST_MEASURED).all():  # nor NaN
            self.imu.append(ImuSample(stamp_ns, rotation @ turning, rotation @ force))
        else:
            self.counts.unusable += 1


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
