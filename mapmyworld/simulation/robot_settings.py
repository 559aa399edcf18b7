"""Settings of the simulated robot: its body, sensors, faults and driver."""

from __future__ import annotations

from dataclasses import dataclass, field

from mapmyworld.config.ranges import Count, FromZero, Positive, Quality, Share


@dataclass(frozen=True, slots=True)
class BodySettings:
    """The robot's body."""

    length: Positive = 0.40  # m, of the chassis
    width: Positive = 0.30  # m, of the chassis
    height: Positive = 0.15  # m, of the chassis
    ground_clearance: FromZero = 0.05  # m, from the floor to the chassis
    wheel_radius: Positive = 0.08  # m
    wheel_track: Positive = 0.34  # m between the wheels' centre lines


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """How it is driven."""

    speed: Positive = 0.6  # m/s when driving straight
    turn_rate: Positive = 0.9  # rad/s when turning on the spot
    acceleration: Positive = 0.6  # m/s^2, at most
    turn_acceleration: Positive = 2.5  # rad/s^2, at most
    decision_rate: Positive = 5.0  # Hz at which the driver's fingers move
    pause: FromZero = 1.0  # s of standing still at the start and the end


@dataclass(frozen=True, slots=True)
class LaserSettings:
    """The laser and its faults."""

    enabled: bool = True  # whether the laser records
    rate: Positive = 10.0  # Hz
    beams: Count = 1081  # a sweep
    field_of_view: Positive = 270.0  # deg, centred on straight ahead
    range_min: FromZero = 0.1  # m
    range_max: Positive = 30.0  # m
    noise: FromZero = 0.01  # m, standard deviation of a range
    dropout: Share = 0.002  # share of beams that come back with nothing
    glass_transmission: Share = 0.7  # share of beams that pass glass hit head-on
    mount_x: float = 0.12  # m on the chassis
    mount_z: float = 0.20  # m above the chassis's centre
    latency: FromZero = 0.01  # s from the end of a sweep to its recording


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """The depth camera and its faults."""

    enabled: bool = True  # whether the camera records
    rate: Positive = 10.0  # Hz
    width: Count = 640  # pixels
    height: Count = 480  # pixels
    field_of_view: Positive = 65.0  # deg, horizontal
    depth_min: FromZero = 0.4  # m
    depth_max: Positive = 8.0  # m
    depth_noise: FromZero = 0.0015  # 1/m; the standard deviation is this times the squared depth
    depth_edge: FromZero = 0.05  # share of the depth by which neighbours at an edge differ
    depth_grazing: FromZero = 80.0  # deg between ray and normal, beyond which depth is missing
    image_noise: FromZero = 2.0  # grey values, standard deviation
    blur: FromZero = 0.5  # pixels, standard deviation of the lens's blur
    exposure_change: FromZero = 0.08  # share by which brightness wanders
    compressed: bool = True  # JPEG and PNG instead of raw images
    jpeg_quality: Quality = 90  # of colour images
    mount_x: float = 0.20  # m on the chassis
    mount_z: float = 0.28  # m above the chassis's centre
    mount_pitch: float = 0.0  # deg, positive looks down
    latency: FromZero = 0.04  # s from exposure to recording


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """The wheels and their faults."""

    rate: Positive = 30.0  # Hz
    radius_error: float = 0.003  # share by which the wheels' radii differ from what is believed
    imbalance: float = 0.0006  # share by which the right wheel's radius exceeds the left's
    track_error: float = 0.011  # share by which the track differs from what is believed
    noise: FromZero = 0.002  # m per square root of metre, standard deviation of a wheel's travel
    slip_rate: FromZero = 0.02  # slips a second while moving
    slip_size: FromZero = 0.006  # m, standard deviation of a wheel's loss in one slip
    latency: FromZero = 0.003  # s from measurement to recording


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """The inertial unit and its faults."""

    enabled: bool = True  # whether the inertial unit records
    rate: Positive = 100.0  # Hz
    gyro_noise: FromZero = 0.002  # rad/s, standard deviation
    gyro_bias: float = 0.001  # rad/s, standard deviation of the constant error
    acceleration_noise: FromZero = 0.03  # m/s^2, standard deviation
    latency: FromZero = 0.002  # s from measurement to recording


@dataclass(frozen=True, slots=True)
class ClockSettings:
    """The log's clock and its delays."""

    start: FromZero = 1_700_000_000.0  # s since 1970 at which the log begins
    stamp_jitter: FromZero = 0.0005  # s, standard deviation of a sensor's trigger
    latency_jitter: FromZero = 0.002  # s, mean of the exponential delay on top of each latency


@dataclass(frozen=True, slots=True)
class SimulationSettings:
    """All settings of a simulated recording."""

    body: BodySettings = field(default_factory=BodySettings)
    driver: DriverSettings = field(default_factory=DriverSettings)
    laser: LaserSettings = field(default_factory=LaserSettings)
    camera: CameraSettings = field(default_factory=CameraSettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)
    imu: ImuSettings = field(default_factory=ImuSettings)
    clock: ClockSettings = field(default_factory=ClockSettings)
