"""Many scans aligned with each other at once: all their pairs in one factor graph.

Lu and Milios, "Globally consistent range scan alignment for environment mapping", Autonomous
Robots 4, 1997, with point-to-line residuals that are associated anew in every round: a pair is a
relative pose with the information that its points have of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_covariance import variance_factor
from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.system import System, believed_edges, with_edges
from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_exp
from mapmyworld.kernels.laser_motion import FAINT
from mapmyworld.kernels.scan_pairs import pair_systems
from mapmyworld.parallel import run_in_chunks
from mapmyworld.registration.scan_matching import FINE, ScanSet
from mapmyworld.types import Progress

Pairs = NDArray[np.int64]
_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_NOISE = np.array([[12, 13], [13, 14]])


@dataclass(frozen=True, slots=True, eq=False)
class JointAlignment:
    """What the joint alignment came to."""

    poses: Array
    """(N, 3) of the system's nodes."""
    moved: tuple[float, ...]
    """Root mean square movement of what does not stay in each round, metres."""
    residual: float
    """Root mean square distance between a point and the other scan's line, metres."""
    joint: System
    """Of the last round: the edges that were given, then the pairs."""
    pairs: int
    """How many these are."""


def align_in_rounds(
    scans: ScanSet,
    system: System,
    poses: Array,
    pairs_at: Callable[[Array], Pairs],
    config: Config,
    progress: Progress,
    max_distances: Array = FINE,
) -> JointAlignment:
    """Poses (N, 3) that fit pairs of scans and the system's edges best, from far off on.

    The scans are the system's first nodes. `pairs_at` chooses the pairs (P, 2) that are worth
    comparing where the poses are, in each round. Points are associated within `max_distances` (K,),
    in metres, one of them a round. Within the last of these the variance of points is what the
    solution before shows of it.
    """
    moved: list[float] = []
    variance = _point_variance(config)
    for reach in max_distances:
        before, pairs = poses, pairs_at(poses)
        systems = _associated(scans, before, pairs, reach, config)
        every = with_edges(system, *pair_edges(before, pairs, systems, variance))
        joint = believed_edges(every, np.ones(len(every.tails), np.bool_))
        poses = optimised_roughly(joint, poses, steps=1)
        if reach == max_distances[-1]:  # beyond it points miss by more than they err
            variance *= variance_factor(joint, len(pairs), poses)
        moved.append(_length((poses - before)[joint.free >= 0, :2]))
        weights = max(float(systems[:, 9].sum()), 1e-9)
        residual = float(np.sqrt(systems[:, 10].sum() / weights))
        progress.update(len(moved))
        decided(
            "refine",
            f"{len(pairs)} pairs of scans, moved by {moved[-1]:.4f} m, residual {residual:.4f} m",
        )
    return JointAlignment(poses, tuple(moved), residual, joint, len(pairs))


def pair_edges(
    poses: Array, pairs: Pairs, systems: Array, variance: float
) -> tuple[Pairs, Pairs, Array, Array]:
    """Tails and heads, (P,) both, relative poses (P, 3) and information (P, 3, 3) of pairs (P, 2).

    They are where the minimum of each pair's normal equations, `systems` (P, 15), lies, seen from
    `poses` (N, 3). Points have this `variance` (m^2) across the other scan's line.
    """
    kept = without_noise(systems)
    known = kept @ systems[:, _UPPER] @ kept / variance
    pull = kept @ systems[:, 6:9, None] / variance
    information = known + FAINT * np.eye(3)
    step = np.asarray(np.linalg.solve(information, -pull)[:, :, 0])
    tails, heads = pairs.T
    measured = compose_planar(between_planar(poses[tails], poses[heads]), planar_exp(step))
    return tails, heads, measured, information


def _point_variance(config: Config) -> float:
    """Variance (m^2) of points across another scan's line, before pairs show what it is."""
    settings = config.registration
    return settings.range_sigma**2 * settings.correlation * 2.0


def _length(shifts: Array) -> float:
    """Root mean square (m) of shifts (K, 2)."""
    return float(np.sqrt(np.sum(shifts**2) / max(len(shifts), 1)))


def _associated(scans: ScanSet, poses: Array, pairs: Pairs, reach: float, config: Config) -> Array:
    """(P, 15) the normal equations of all pairs at `poses`."""
    scale, systems = config.registration.residual_share * reach, np.zeros((len(pairs), 15))

    def work(first: int, last: int) -> None:
        pair_systems(
            first, last, scans.rows, scans.bounds, scans.origins, pairs, poses, reach, scale,
            systems,
        )  # fmt: skip

    run_in_chunks(work, len(pairs), config.threads)
    return systems


def without_noise(systems: Array) -> Array:
    """(P, 3, 3) by what pairs of these `systems` (P, 15) count: in the direction of the plane that
    is known least, by the share that is not from errors of normals.

    Along a bare wall all is, and it draws all scans alike together. Where there is more, it makes
    steps too short, and their errors larger: a pair is known by the square of the share.
    """
    known, noise = systems[:, _UPPER[:2, :2]], systems[:, _NOISE]
    values, vectors = np.linalg.eigh(known)
    way = vectors[:, :, 0]
    false = np.einsum("pi,pij,pj->p", way, noise, way)
    least = np.maximum(values[:, 0], np.finfo(np.float64).tiny)
    lost = np.minimum(false, least) / least
    kept = np.tile(np.eye(3), (len(systems), 1, 1))
    kept[:, :2, :2] -= lost[:, None, None] * way[:, :, None] * way[:, None, :]
    return kept
