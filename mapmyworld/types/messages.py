"""What a log holds: raw messages, decoded on demand, and the typed messages they become."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


class MessageKind(StrEnum):
    """What a message means to mapping; everything else is OTHER and ignored."""

    IMAGE = "image"
    CAMERA_INFO = "camera_info"
    LASER_SCAN = "laser_scan"
    POINT_CLOUD = "point_cloud"
    ODOMETRY = "odometry"
    IMU = "imu"
    TRANSFORMS = "transforms"
    POSE = "pose"
    GPS = "gps"
    TEXT = "text"
    OTHER = "other"


@dataclass(frozen=True, slots=True, eq=False)
class ImageMessage:
    """A colour, grey or depth image whose pixels are decoded when asked for."""

    kind: ClassVar = MessageKind.IMAGE
    stamp_ns: int
    frame_id: str
    encoding: str
    """ROS name ("rgb8", "bgr8", "mono8", "16UC1", "32FC1", ...), after decompression."""
    width: int
    """Pixels; 0 where only decoding indicates (compressed images)."""
    height: int
    pixels: Callable[[], NDArray[np.generic]]
    """Colour (H, W, 3) uint8 RGB, grey (H, W) uint8, depth (H, W) float32 metres (0 = none)."""
    encoded: bytes | None = None
    """The JPEG or PNG file as recorded or stored, where there is one."""

    @property
    def is_depth(self) -> bool:
        """By the encoding."""
        return self.encoding.upper() in {"16UC1", "32FC1", "MONO16", "Z16"}


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfoMessage:
    """Intrinsics of a camera, as recorded."""

    kind: ClassVar = MessageKind.CAMERA_INFO
    stamp_ns: int
    frame_id: str
    width: int
    height: int
    distortion_model: str
    """"plumb_bob", "rational_polynomial" or "equidistant"; empty means none."""
    distortion: NDArray[np.float64]
    """(D,) coefficients in OpenCV's order."""
    intrinsics: NDArray[np.float64]
    """(3, 3), K."""
    rectification: NDArray[np.float64]
    """(3, 3), R."""
    projection: NDArray[np.float64]
    """(3, 4), P."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserScanMessage:
    """One planar sweep as recorded; ranges may hold NaN, inf, 0 or a no-return value."""

    kind: ClassVar = MessageKind.LASER_SCAN
    stamp_ns: int
    """Time of the first beam."""
    frame_id: str
    angle_min: float  # rad
    angle_increment: float  # rad
    time_increment: float  # s between beams; 0 = unknown
    scan_time: float  # s between sweeps; 0 = unknown
    range_min: float  # m
    range_max: float  # m
    ranges: NDArray[np.float32]
    """(N,) metres."""
    intensities: NDArray[np.float32]
    """(N,) or (0,)."""


@dataclass(frozen=True, slots=True, eq=False)
class PointCloudMessage:
    """Points (N, 3) float32 metres of the sensor frame, rows with NaN left out."""

    kind: ClassVar = MessageKind.POINT_CLOUD
    stamp_ns: int
    frame_id: str
    points: NDArray[np.float32]
    colours: NDArray[np.uint8] | None
    """(N, 3) RGB."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryMessage:
    """Pose of `child_frame_id` in `frame_id`, with covariances in ROS order (translation first)."""

    kind: ClassVar = MessageKind.ODOMETRY
    stamp_ns: int
    frame_id: str
    child_frame_id: str
    pose: NDArray[np.float64]
    """(4, 4)."""
    pose_covariance: NDArray[np.float64]
    """(6, 6), x y z roll pitch yaw; all zero = unknown."""
    twist: NDArray[np.float64]
    """(6,), vx vy vz wx wy wz of the child frame, m/s and rad/s."""
    twist_covariance: NDArray[np.float64]
    """(6, 6)."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuMessage:
    """Turning rates and accelerations."""

    kind: ClassVar = MessageKind.IMU
    stamp_ns: int
    frame_id: str
    orientation: NDArray[np.float64] | None
    """(4,) x y z w; None where the device gives none."""
    angular_velocity: NDArray[np.float64]
    """(3,) rad/s."""
    linear_acceleration: NDArray[np.float64]
    """(3,) m/s^2."""


@dataclass(frozen=True, slots=True, eq=False)
class TransformStamped:
    """`parent_from_child` (4, 4) at a time."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TransformsMessage:
    """Poses of frames in frames, as tf has them."""

    kind: ClassVar = MessageKind.TRANSFORMS
    transforms: tuple[TransformStamped, ...]
    static: bool

    @property
    def stamp_ns(self) -> int:
        """Of the first transform; 0 without any."""
        return self.transforms[0].stamp_ns if self.transforms else 0


@dataclass(frozen=True, slots=True, eq=False)
class PoseMessage:
    """A pose with covariance (6, 6; translation first), as a localiser gives it."""

    kind: ClassVar = MessageKind.POSE
    stamp_ns: int
    frame_id: str
    pose: NDArray[np.float64]
    """(4, 4)."""
    covariance: NDArray[np.float64]
    """(6, 6), translation first."""


@dataclass(frozen=True, slots=True, eq=False)
class GpsMessage:
    """A position on earth; latitude and longitude are NaN where the receiver had no fix."""

    kind: ClassVar = MessageKind.GPS
    stamp_ns: int
    frame_id: str
    latitude: float  # deg
    longitude: float  # deg
    altitude: float  # m above the ellipsoid
    error: float  # m, standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class TextMessage:
    """A text."""

    kind: ClassVar = MessageKind.TEXT
    stamp_ns: int
    text: str


Message = (
    ImageMessage
    | CameraInfoMessage
    | LaserScanMessage
    | PointCloudMessage
    | OdometryMessage
    | ImuMessage
    | TransformsMessage
    | PoseMessage
    | GpsMessage
    | TextMessage
)


@dataclass(frozen=True, slots=True, eq=False)
class RawMessage:
    """One record of a log; `decode()` gives its typed message or raises `LogError`."""

    topic: str
    kind: MessageKind
    log_time_ns: int
    """When it was recorded. Orders messages, measures nothing."""
    stamp_ns: int | None
    """Header stamp, read without decoding the rest; None where the type has no header."""
    decode: Callable[[], Message]
