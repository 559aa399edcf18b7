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
from mapmyworld.kernels.scan_alignment import pair_systems
from mapmyworld.parallel import run_in_chunks
from mapmyworld.registration.scan_matching import FINE, ScanSet
from mapmyworld.types import Progress

Pairs = NDArray[np.int64]
_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_OPEN = 0.01  # share of the best known direction's information up to which another is open


@dataclass(frozen=True, slots=True, eq=False)
class JointAlignment:
    """What the joint alignment came to."""

    poses: Array
    """(N, 3)."""
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
    """Poses (N, 3) that fit pairs of scans and the system's edges best, from poses far off on.

    The scans are the system's first nodes. `pairs_at` chooses the pairs (P, 2) that are worth
    comparing where the poses are, in each round. Points are associated within `max_distances` (K,),
    in metres, one of them a round. Within the last of these their variance is what the pairs of the
    round before show of it.
    """
    moved: list[float] = []
    variance = _point_variance(config)
    for reach in max_distances:
        pairs = pairs_at(poses)
        systems = _associated(scans, poses, pairs, reach, config)
        every = with_edges(system, *pair_edges(poses, pairs, systems, variance))
        joint = believed_edges(every, np.ones(len(every.tails), np.bool_))
        before, poses = poses, optimised_roughly(joint, poses, steps=1)
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


def counted_once(
    scans: ScanSet, poses: Array, pairs: Pairs, information: Array, config: Config
) -> Array:
    """(P, 3, 3) what tracked motions know beside pairs, which compare the same points.

    Motions between the `pairs` (P, 2) of scans at `poses` (S, 3) state `information` (P, 3, 3).
    Each was matched by the points that the pair of its two scans compares anew, so it is the same
    measurement. But tracking learns how well matches agree, not what they err by in common: by that
    its motions would outweigh all pairs. So they count by the median share of what pairs know of
    theirs. Where a pair knows less than that of its motion, as along a bare wall, the motion rests
    on odometry, which no pair measures anew.
    """
    if len(pairs) == 0:
        return information
    systems = _associated(scans, poses, pairs, float(FINE[0]), config)
    known = pair_edges(poses, pairs, systems, _point_variance(config))[3] - FAINT * np.eye(3)
    values, axes = np.linalg.eigh(information)
    root = axes * np.sqrt(np.maximum(values, 1e-12))[:, None, :]
    whitened = np.linalg.solve(root, np.linalg.solve(root, known).swapaxes(1, 2))
    shares, axes = np.linalg.eigh(whitened)
    share = min(1.0, float(np.median(shares)))
    decided("refine", f"motions count by {share:.3f} where pairs know as much of them")
    twice = np.clip(shares, 0.0, share) / max(share, 1e-12)
    left = root @ (axes * np.sqrt(1.0 - (1.0 - share) * twice)[:, None])
    return np.asarray(left @ left.swapaxes(1, 2))


def pair_edges(
    poses: Array, pairs: Pairs, systems: Array, variance: float
) -> tuple[Pairs, Pairs, Array, Array]:
    """Tails and heads, (P,) both, relative poses (P, 3) and information (P, 3, 3) of pairs (P, 2).

    They are where the minimum of each pair's normal equations, `systems` (P, 15), lies, seen from
    `poses` (N, 3). Points have this `variance` (m^2) across the other scan's line.
    """
    kept = without_open(systems[:, _UPPER])
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


def without_open(known: Array) -> Array:
    """(P, 3, 3) projections of pairs without the direction of the plane that walls leave open.

    Pairs with normal matrices `known` (P, 3, 3) have some information there, for the noise of their
    normals alone: along a corridor that pulls scans together, and all pairs alike.
    """
    values, vectors = np.linalg.eigh(known[:, :2, :2])
    along = np.where((values[:, 0] < _OPEN * values[:, 1])[:, None], vectors[:, :, 0], 0.0)
    kept = np.tile(np.eye(3), (len(known), 1, 1))
    kept[:, :2, :2] -= along[:, :, None] * along[:, None, :]
    return kept
