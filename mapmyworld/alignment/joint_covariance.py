"""How certain scans are after their joint alignment.

Points of a scan err together: its whole shape is turned and shifted a little against the robot, and
every pair that it is in follows. So what pairs measure, taken by how much they contradict each
other, indicates how these shapes lie, and each scan's own noise comes on top of it, once. What is
left of a scan's errors, as those behind it see it and those ahead, is common to its pairs as well:
all of them measure once, or a long path would be known as well as pairs are many.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.connected_components import first_nodes
from mapmyworld.backend.information import NotPositiveDefiniteError
from mapmyworld.backend.system import System, believed_edges, chosen_edges, edge_chi2
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar, planar_adjoint
from mapmyworld.geometry.rigid import transported
from mapmyworld.graph.covariance import RelativeCovariances
from mapmyworld.kernels.laser_motion import FAINT
from mapmyworld.registration.scan_matching import ScanSet


def variance_factor(joint: System, pairs: int, poses: Array) -> float:
    """By what the variances of the system's last `pairs` are to be multiplied.

    One variance component: their squared sigmas at `poses` (N, 3) over their redundancy, times how
    many pairs there are a scan. Directions that their points leave open are no measurements.
    """
    if pairs == 0:
        return 1.0
    squares, known = float(edge_chi2(joint, poses)[-pairs:].sum()), joint.information[-pairs:]
    measured = np.einsum("pij,pji->", known - FAINT * np.eye(3), np.linalg.inv(known))
    scans = np.unique(np.concatenate([joint.tails[-pairs:], joint.heads[-pairs:]]))
    free = int(np.count_nonzero(joint.free[scans] >= 0))
    redundancy = float(measured) - joint.dimension * free
    factor = squares / redundancy if redundancy > 0 and squares > 0.0 else 1.0
    return factor * max(1.0, pairs / max(1, free))


@dataclass(frozen=True, slots=True, eq=False)
class RelativeCertainty:
    """How certainly N poses lie beside each other, by scans whose joint alignment shapes a map."""

    joint: System
    """Of these scans, its first nodes."""
    scans: Array
    """(S, 3) where its nodes are."""
    poses: Array
    """(N, 3)."""
    near: Index
    """(N,) the scan that each pose errs with."""
    against: Array
    """(N, 3, 3) what it errs by against that scan."""

    @staticmethod
    def of(joint: System, poses: Array, count: int) -> RelativeCertainty:
        """That of the first `count` nodes of a system, whose N nodes are at `poses` (N, 3)."""
        exact = np.zeros((count, 3, 3))
        return RelativeCertainty(joint, poses, poses[:count], np.arange(count), exact)

    def carried_to(self, poses: Array, row: Index) -> RelativeCertainty:
        """That of other poses (M, 3), which move with the known ones at `row` (M,)."""
        against = carried(self.against[row], self.poses[row], poses)
        return replace(self, poses=poses, near=self.near[row], against=against)

    def standard_deviations(self, pairs: Index) -> Array:
        """(P,) m of the second's place, seen from the first, of pairs (P, 2) of poses.

        In the direction in which it is known least; infinite where nothing holds a pose.
        """
        (a, b), (tails, heads) = pairs.T, self.near[pairs].T
        spread, apart = np.zeros((len(pairs), 3, 3)), tails != heads
        try:
            known = RelativeCovariances.of(self.joint, self.scans)
        except NotPositiveDefiniteError:
            return np.full(len(pairs), np.inf)
        spread[apart] = known.between(tails[apart], heads[apart])
        a_in_b = planar_adjoint(between_planar(self.poses[b], self.poses[a]))
        spread = carried(spread, self.scans[heads], self.poses[b])
        spread += self.against[b] + transported(a_in_b, self.against[a])
        return np.asarray(np.sqrt(np.linalg.eigvalsh(spread[:, :2, :2])[:, 1]))


def without_unmatched(joint: System, pairs: int, blind: Index, ahead: int) -> System:
    """The system without some of its last `pairs`.

    Left out are those between scans of one visit, up to `ahead` apart, where odometry alone
    measured a motion: `blind` (S,) counts such motions before each scan. Tracking found nothing
    there that fits. Points that lie near each other all the same draw poses as they may, but
    whether they are of one surface nothing shows.
    """
    others = len(joint.tails) - pairs
    ends = np.stack([joint.tails[others:], joint.heads[others:]])
    unmatched = (np.diff(blind[ends], axis=0) > 0) & (np.diff(ends, axis=0) <= ahead)
    kept = np.append(np.ones(others, np.bool_), ~unmatched[0])
    return chosen_edges(joint, kept)


def are_known_within(
    system: System, poses: Array, pairs: NDArray[np.int64], reach: float
) -> NDArray[np.bool_]:
    """(P,) of which pairs (P, 2) of nodes the edges show at `poses` (N, 3) how they lie.

    The standard deviation of their relative position is less than `reach` (m), the distance within
    which points are associated. Beyond it these may lie on other walls that look the same, as
    between equal doors of a corridor, and no later round would notice.
    """
    anchored = believed_edges(system, np.ones(len(system.tails), np.bool_))
    try:
        spread = RelativeCovariances.of(anchored, poses).between(*pairs.T)
    except NotPositiveDefiniteError:
        return np.ones(len(pairs), np.bool_)
    return np.asarray(np.linalg.eigvalsh(spread[:, :2, :2])[:, 1] < reach**2)


def shape_covariances(scans: ScanSet, residual: float) -> Array:
    """(S, 3, 3) by how much points that err by `residual` (m) turn and shift a scan's shape.

    By a metre and a radian, where they do not hold it.
    """
    x, y, nx, ny = scans.rows[:, :4].T.astype(np.float64)
    slopes, known = (nx, ny, ny * x - nx * y), np.empty((len(scans), 3, 3))
    for i, j in np.ndindex(3, 3):  # each by itself: points are many
        sums = np.append(0.0, np.cumsum(slopes[i] * slopes[j]))
        known[:, i, j] = np.diff(sums[scans.bounds])
    variance = residual**2
    return np.asarray(variance * np.linalg.pinv(known + variance * np.eye(3), hermitian=True))


def of_anchors(joint: System, own: Array, poses: Array) -> Array:
    """(N, 3, 3) what the noise of the scan that stays in each component adds at `poses` (N, 3).

    `own` (S, 3, 3) is that of all scans. Nothing where a prior places the component.
    """
    anchor = first_nodes(len(joint.free), joint.tails, joint.heads)
    scanned = anchor < len(own)
    adjoint = planar_adjoint(between_planar(poses, poses[anchor]))
    found = transported(adjoint, own[np.where(scanned, anchor, 0)])
    found[~scanned | (joint.free[anchor] >= 0)] = 0.0
    return found


def carried(covariances: Array, poses: Array, others: Array) -> Array:
    """Covariances (N, 3, 3) of poses (N, 3), as of others (N, 3) that move with them: (N, 3, 3)."""
    return transported(planar_adjoint(between_planar(others, poses)), covariances)
