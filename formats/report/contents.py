"""What a report shows, as values: gathered by the command line, drawn by this package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.types import ConstraintKind, OccupancyGrid, PointCloud


@dataclass(frozen=True, slots=True, eq=False)
class ShownNodes:
    """The nodes that have a place in the map, as parallel arrays in time order."""

    ids: NDArray[np.int64]
    """(N,) ids."""
    sessions: NDArray[np.int64]
    """(N,) of each node."""
    times_s: Array
    """(N,) since the first node."""
    places: Array
    """(N, 3) x, y, yaw in the map."""
    sigmas_m: Array | None
    """(N,) one sigma of position relative to the first node."""
    ellipses: Array | None
    """(N, 3) half axes (m, one sigma) and the angle (rad) of the first one in the map."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownConstraint:
    """A constraint against the solution."""

    from_id: int
    to_id: int
    kind: ConstraintKind
    accepted: bool
    reason: str
    residual: tuple[float, float, float] | None
    """Metres, degrees and sigmas by which the solved poses miss it."""
    start: tuple[float, float] | None
    """Metres and degrees by which the path before any closure missed it."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageMatches:
    """What two images have in common; pixels of the full-size images."""

    pixels_a: NDArray[np.float32]
    """(M, 2) of the first image."""
    pixels_b: NDArray[np.float32]
    """(M, 2) of the second image."""
    agreed: NDArray[np.bool_]
    """(M,) whether a match agrees with the motion."""
    common_words: int
    features: tuple[int, int]
    """Features that the two images have."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Why one closure was accepted or rejected, to look at."""

    index: int
    """Of its constraint among those shown."""
    start: Array
    """(3,) a_from_b as x, y, yaw by tracking alone."""
    measured: Array
    """(3,) by the constraint."""
    matches: ImageMatches | None


@dataclass(frozen=True, slots=True, eq=False)
class NodePicture:
    """A node's image, small."""

    jpeg: bytes
    width: int
    height: int
    scale: float
    """Pixels of this picture for one of the image it was made of."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportContents:
    """Everything on the page."""

    name: str
    version: str
    headline: Sequence[tuple[str, str]]
    products: Sequence[tuple[str, str]]
    """Links to the files beside the map, and what they are."""
    verdict: str
    """One sentence: is this map whole, and what holds it together."""
    proof: str
    """What is known of the solution: is it the best one that there is."""
    problems: Sequence[str]
    grid: OccupancyGrid | None
    path: Array
    """(F, 3) time since the first node, x, y of all tracked frames."""
    odometry: Array
    """(N, 2) the recorded odometry of the nodes, laid upon the map at the first one."""
    nodes: ShownNodes
    constraints: Sequence[ShownConstraint]
    evidence: Sequence[Evidence]
    evidence_left_out: int
    pictures: Mapping[int, NodePicture]
    scans: Mapping[int, NDArray[np.float32]]
    """Node -> points (P, 2) in its base frame, of those in `evidence`."""
    cloud: PointCloud | None
    decisions: Sequence[tuple[str, str, str]]
    """What was chosen in the log, and why."""
    notes: Sequence[str]
    diagnosis: Sequence[tuple[bool, str, str]]
    """Comparisons of the sensors: whether one is sound, what was found, what to do."""
    settings: Sequence[tuple[str, str, str]]
    """Changed settings: name, value, default."""
    reproduce: str
    """The command line that makes this map again."""
    overconfidence: Mapping[str, float] = field(default_factory=dict)
    timing: Mapping[str, Any] | None = None
    """What `MAP.timing.json` holds: not part of the map, and different at every build."""
