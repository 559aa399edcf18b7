"""Wheels calibrated by the camera: what images indicate about the motion between nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.backend.block_matrix import diagonals
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    information_from_planar,
    information_to_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.kernels.wheel_model import OUTLIER
from mapmyworld.odometry.motion_calibration import CalibratedMotions
from mapmyworld.odometry.tracking_losses import NAMED
from mapmyworld.places.drift import WHEELS
from mapmyworld.types import (
    CorrectedOdometry,
    ImageMatch,
    Judge,
    Judged,
    Node,
    Verdict,
    Why,
)

_ENOUGH = 20  # motions from which wheels can be calibrated
_VAGUE = Why.UNCERTAIN_TRANSLATION, Why.UNCERTAIN_ROTATION


@dataclass(frozen=True, slots=True, eq=False)
class WheelCheck:
    """How the recorded odometry between N nodes compares with images."""

    motions: CalibratedMotions
    """N - 1, between successive nodes."""
    seen: int
    """How many of them images measured as well as a closure must be known."""
    missed: Array
    """(N - 1, 3) by what images differ from the calibrated odometry: m, m, rad. 0 if not seen."""
    slips: Index
    """(K,) which of them wheels and images indicate differently, by the noise of both."""
    vague: Array
    """(N - 1, 3, 3) information of what images measured less well; 0 if they did not."""
    stamps_ns: Index
    """(N,) of the nodes."""

    @property
    def source(self) -> CorrectedOdometry:
        """What was found, as the source of corrected motions."""
        scale, *_, by_metre, by_radian = self.motions.errors[0].tolist()
        return CorrectedOdometry(scale, by_radian, float(np.degrees(by_metre)))

    def motion(self) -> tuple[Array, Array]:
        """The motions (N - 1, 3) that wheels measured, and vague images with them, and their
        information (N - 1, 3, 3). One that images contradict is as uncertain as it is off.
        """
        variances = self.motions.variances()
        variances[self.slips] += self.missed[self.slips] ** 2
        information = diagonals(1.0 / variances) + self.vague
        pull = self.vague @ self.missed[:, :, None]
        return self.motions.measured() + np.linalg.solve(information, pull)[:, :, 0], information

    def lines(self) -> tuple[str, ...]:
        """What a user should know."""
        source, slips = self.source, self.slips
        along, across, heading = np.sqrt(self.motions.noise[0]).tolist()
        head = (
            f"recorded odometry against visual odometry over {self.seen} motions: distance "
            f"{source.distance_share:+.1%}, rotation {source.turn_share:+.1%}, heading "
            f"{source.degrees_per_m:+.2f} deg per m; it errs by {along:.3f} m, {across:.3f} m, "
            f"{np.degrees(heading):.1f} deg a metre along, across and in heading; {len(slips)} "
            "contradictions"
        )
        metres, radians = np.hypot(*self.missed.T[:2]), np.abs(self.missed[:, 2])
        worst = slips[np.argsort(-metres[slips] - radians[slips], kind="stable")][:NAMED]
        named = [
            f"at {self.stamps_ns[k + 1] * 1e-9:.2f} s recorded and visual odometry differ by "
            f"{metres[k]:.3f} m, {np.degrees(radians[k]):.1f} deg"
            for k in np.sort(worst).tolist()
        ]
        return head, *named


def check_wheels(nodes: Sequence[Node], constraints: Sequence[Judged]) -> WheelCheck | None:
    """The recorded odometry of a log's `nodes` against image pairs; None where those are few."""
    row, seen = {node.id: k for k, node in enumerate(nodes)}, dict[int, Judged]()
    for c in constraints:
        follows = row.get(c.to_id) == row.get(c.from_id, -2) + 1
        if follows and isinstance(c.source, ImageMatch) and c.source.steps == 1 and _fits(c):
            seen[row[c.from_id]] = c
    rows, before = np.array(list(seen), np.int64), np.arange(len(nodes) - 1)
    sharp = rows[[c.accepted for c in seen.values()]]
    if len(sharp) < _ENOUGH:
        return None
    found, own = np.zeros((len(before), 3)), np.zeros((len(before), 3, 3))
    found[rows] = matrix_to_planar(np.stack([c.i_from_j for c in seen.values()]))
    own[rows] = information_to_planar(np.stack([c.information for c in seen.values()]))
    motions = CalibratedMotions(nodes, (before, before + 1), found, np.isin(before, sharp))
    missed = np.where(np.isin(before, rows)[:, None], motions.missed(found), 0.0)
    variances = motions.variances()[rows] + np.linalg.inv(own[rows]).diagonal(0, 1, 2)
    contradicts = rows[np.sum(missed[rows] ** 2 / variances, axis=1) > OUTLIER]
    own[sharp] = own[contradicts] = 0.0
    stamps = np.array([node.stamp_ns for node in nodes], np.int64)
    slips = np.intersect1d(contradicts, sharp)
    return WheelCheck(motions, len(sharp), missed, slips, own, stamps)


def _fits(pair: Judged) -> bool:
    """Whether enough of two images agrees, however uncertain the motion that it agrees on."""
    return pair.accepted or pair.verdicts[-1].why in _VAGUE


def corrected(
    nodes: Sequence[Node], constraints: Sequence[Judged], check: WheelCheck
) -> list[Judged]:
    """The constraints; motions that wheels measured are calibrated by `check`.

    The model of wheels takes one motion's error to know nothing of the next one's. An error that
    all motions share adds up much faster where images measure none of them. What images measured
    too vaguely for a constraint of its own joins the wheels.
    """
    row = {node.id: k for k, node in enumerate(nodes)}
    planar, known = check.motion()
    measured, information = planar_to_matrix(planar), information_from_planar(known)
    verdict = Verdict(Judge.CAMERA, False, Why.CORRECTED)

    def mended(c: Judged) -> Judged:
        k = row[c.from_id]
        return replace(c, i_from_j=measured[k], information=information[k], source=check.source)

    by_wheels = [isinstance(c.source, WHEELS) for c in constraints]
    return [
        *(c.judged(verdict) if of else c for c, of in zip(constraints, by_wheels, strict=True)),
        *(mended(c) for c, of in zip(constraints, by_wheels, strict=True) if of),
    ]
