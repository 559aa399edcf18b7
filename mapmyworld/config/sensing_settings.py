"""Settings of the plan and of the way from messages to frames and nodes."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import FromZero, Positive, Shift


@dataclass(frozen=True, slots=True)
class SensingConfig:
    """Settings of the plan, of frames and of nodes."""

    scan_topic: str = ""  # empty = chosen by the plan
    colour_topic: str = ""  # empty = chosen by the plan
    depth_topic: str = ""  # empty = chosen by the plan
    camera_info_topic: str = ""  # empty = chosen by the plan
    odometry_topic: str = ""  # empty = chosen by the plan; "tf" = from transforms; "none"
    base_frame: str = ""  # empty = chosen by the plan
    scan_mount: str = ""  # "x y z roll pitch yaw" of the laser on the base; empty = from tf
    camera_mount: str = ""  # the same for the camera's optical frame; empty = from tf
    odometry_offset: Shift = 0.0  # s added to the stamps of the odometry; 0 = by what is measured
    scan_offset: Shift = 0.0  # s added to the stamps of the laser
    camera_offset: Shift = 0.0  # s added to the stamps of the cameras
    imu_offset: Shift = 0.0  # s added to the stamps of the inertial sensor
    image_tolerance: FromZero = 0.02  # s between colour and depth of one frame
    frame_tolerance: FromZero = 0.05  # s between the sensors of one frame
    node_distance: FromZero = 0.1  # m of motion that makes a new node
    node_angle: FromZero = 0.1  # rad of rotation that makes a new node
    cloud_lowest: float = 0.2  # m above the base: the slice of a 3D lidar's points that is a scan
    cloud_highest: float = 2.0  # m above the base, of the same slice
    cloud_nearest: FromZero = 0.5  # m from a 3D lidar within which its points are the robot itself
    cloud_spacing: Positive = 0.1  # m between the points of a 3D lidar that a node keeps
    use_scans: bool = True  # whether laser scans are used
    use_images: bool = True  # whether camera images are used
