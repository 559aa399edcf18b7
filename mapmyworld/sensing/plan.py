"""The plan: which topics, frames and clock to use, and why; every problem at once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import SensingConfig
from mapmyworld.sensing.motion import RecordedMotion
from mapmyworld.sensing.survey import Survey
from mapmyworld.types import CameraModel, MapStore


@dataclass(frozen=True, slots=True)
class Decision:
    """What was chosen for a role, why, and why the others were not."""

    role: str
    choice: str
    """Empty when nothing serves."""
    reason: str
    others: tuple[str, ...] = ()
    """"candidate: why not", best first."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanSource:
    """The lidar that the map is made with."""

    topic: str
    base_from_lidar: NDArray[np.float64]
    """(4, 4)."""
    beams_are_timed: bool
    """Whether its messages report when each beam was taken."""
    is_cloud: bool = False
    """Whether it is a 3D lidar, of whose points a slice serves as scan."""
    seconds_a_radian: float = 0.0
    """By which untimed beams follow each other, where the log shows it; else 0."""

    @property
    def is_deskewed(self) -> bool:
        """Whether it is known when each beam was taken."""
        return self.beams_are_timed or self.seconds_a_radian != 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraSource:
    """A camera: colour, depth and its model."""

    colour_topic: str
    depth_topic: str
    model: CameraModel
    grey_bits: int = 0
    """Bits of a 16-bit grey image's pixels; 0 where colour has eight a channel."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySource:
    """Where the motion comes from."""

    name: str
    """The topic, or "tf odom -> base"."""
    motion: RecordedMotion
    """odom_from_base."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuSource:
    """The inertial unit."""

    topic: str
    base_from_imu: NDArray[np.float64]
    """(4, 4); only its rotation is used."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What building takes from the log, and why."""

    scan: ScanSource | None
    camera: CameraSource | None
    odometry: OdometrySource | None
    imu: ImuSource | None
    ground_truth_topic: str
    gps_topic: str
    """Of fixes, which are kept with the nodes and not used for the map; empty without any."""
    base_frame: str
    map_from_first: NDArray[np.float64]
    """(4, 4) where the map puts the first pose of a log without odometry: level, z up."""
    planar: bool
    """Whether the robot moves in a plane: the graph is then optimised in 2D."""
    use_log_time: bool
    """Whether header stamps are unusable, so that log time serves instead."""
    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...]
    """What the user should know; nothing is lost by it."""
    losses: tuple[str, ...]
    """What had to be left out or assumed: the map is partial."""
    sort_ns: int = 0
    """How long messages wait to be put in the order of their header stamps; 0: the log's order."""
    more_cameras: tuple[CameraSource, ...] = ()
    """Cameras that look elsewhere than `camera`; their images join its own."""
    sweep_motion: RecordedMotion | None = None
    """By which sweeps are deskewed where no odometry measures it."""

    def with_odometry_shifted(self, seconds: float) -> Plan:
        """The same plan with so much added to the stamps of the odometry."""
        if self.odometry is None:
            return self
        motion = self.odometry.motion.shifted(seconds)
        return replace(self, odometry=OdometrySource(self.odometry.name, motion))

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that building reads, tf and odometry apart: those are known already."""
        found = [self.scan.topic] if self.scan else []
        for camera in (self.camera, *self.more_cameras):
            found += [camera.colour_topic, camera.depth_topic] if camera else []
        found += [self.imu.topic] if self.imu else []
        return tuple(t for t in [*found, self.ground_truth_topic, self.gps_topic] if t)


@dataclass(slots=True)
class Draft:
    """The plan in the making: what the rules find is written here."""

    survey: Survey
    config: SensingConfig
    decisions: list[Decision] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def decide(self, role: str, choice: str, reason: str, others: tuple[str, ...] = ()) -> None:
        """Notes what was chosen for a role, and why."""
        self.decisions.append(Decision(role, choice, reason, others))


def moves_in_plane(store: MapStore) -> bool:
    """Whether the plan that a map keeps says so; not where a map keeps none."""
    return bool((store.get("plan") or {}).get("planar", False))
