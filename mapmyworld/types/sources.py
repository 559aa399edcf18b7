"""What measured a constraint, with the figures of the measurement."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Given:
    """A file, or the map itself: nothing more is known of it."""

    by: str = ""


GIVEN = Given()


@dataclass(frozen=True, slots=True)
class Odometry:
    """Recorded odometry."""


@dataclass(frozen=True, slots=True)
class CorrectedOdometry:
    """Recorded odometry, corrected by what images showed all of it to be off by."""

    distance_share: float
    turn_share: float
    degrees_per_m: float = 0.0
    """Of heading, by distance."""


LOST = "lost"
"""State of a motion that neither scans nor odometry measured."""
RELOCALISED = "relocalised"
"""State of a motion that the place afterwards measured, where odometry was refuted."""


@dataclass(frozen=True, slots=True)
class LaserTracking:
    """Scan matching from frame to frame; the figures are those of the least certain one."""

    state: str
    overlap: float
    lost: bool = False
    """Whether the scans before do not say where the robot is."""
    after_gap: bool = False
    """Whether the log has no scan for unusually long before, whatever became of the robot."""
    doubted: bool = False
    """Whether it is odometry that scans afterwards put in doubt."""


@dataclass(frozen=True, slots=True)
class CameraTracking:
    """Visual odometry; the figures are those of the least certain frame."""

    state: str
    inliers: int


@dataclass(frozen=True, slots=True)
class Particles:
    """The path of the best particle."""


@dataclass(frozen=True, slots=True)
class ScanMatch:
    """Submaps of scans aligned; zeros where no pose scored well enough to be aligned."""

    evidence: float = 0.0
    """Points of both that the other confirms, less those that it contradicts."""
    second_best: float = 0.0
    """That of the likeliest other pose."""
    beyond: float = 0.0
    """Evidence beyond the second best's, what only one of them saw by a quarter, and by how many
    points its drift is likelier; else all.
    """
    score: float = 0.0
    """Mean likelihood of the best pose of the search."""
    overlap: float = 0.0
    residual: float = 0.0
    """m."""
    moved: float = 0.0
    """m between the guess and the alignment."""


@dataclass(frozen=True, slots=True)
class ImageMatch:
    """Two images registered; what proposed them is zero where something else did."""

    similarity: float = 0.0
    """Of their words."""
    steps: int = 0
    """Nodes between the two, in sequence."""
    distance: float = 0.0
    """m between the solved poses, by these."""
    matches: int = 0
    inliers: int = 0
    share: float = 0.0
    residual_px: float = 0.0
    sigma_m: float = 0.0
    sigma_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Marker:
    """A marker seen in an image."""

    marker: int
    distance: float
    worst_corner: float
    """Sigmas by which the worst corner misses."""


@dataclass(frozen=True, slots=True)
class Person:
    """A person's edit."""

    action: str
    reason: str


Source = (
    Given | Odometry | CorrectedOdometry | LaserTracking | CameraTracking | Particles
    | ScanMatch | ImageMatch | Marker | Person
)  # fmt: skip
