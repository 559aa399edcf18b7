"""Wheels calibrated by the camera: what images indicate about the motion between nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    covariance_from_planar,
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
_OUT_OF_PLANE = 1e-8  # rad^2 and m^2 by which a planar robot leaves its plane, a motion


@dataclass(frozen=True, slots=True, eq=False)
class WheelCheck:
    """How the recorded odometry between N nodes compares with images."""

    motions: CalibratedMotions
    """N - 1, between successive nodes."""
    seen: int
    """How many of them images measured."""
    missed: Array
    """(N - 1, 3) by what images differ from the calibrated odometry: m, m, rad. 0 if not seen."""
    slips: Index
    """(K,) which of them wheels and images indicate differently, by the noise of both."""
    stamps_ns: Index
    """(N,) of the nodes."""

    @property
    def source(self) -> CorrectedOdometry:
        """What was found, as the source of corrected motions."""
        scale, *_, by_metre, by_radian = self.motions.errors[0].tolist()
        return CorrectedOdometry(scale, by_radian, float(np.degrees(by_metre)))

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
    """The recorded odometry of `nodes` against image pairs; None where too few were matched."""
    row, seen = {node.id: k for k, node in enumerate(nodes)}, dict[int, Judged]()
    for c in constraints:
        steps = isinstance(c.source, ImageMatch) and c.accepted and c.source.steps
        if steps == 1 and row.get(c.to_id) == row.get(c.from_id, -2) + 1:
            seen[row[c.from_id]] = c
    if len(seen) < _ENOUGH:
        return None
    rows, before = np.array(list(seen)), np.arange(len(nodes) - 1)
    found, is_found = np.zeros((len(before), 3)), np.isin(before, rows)
    found[rows] = matrix_to_planar(np.stack([c.i_from_j for c in seen.values()]))
    one_robot = [replace(node, session=0) for node in nodes]
    motions = CalibratedMotions(one_robot, (before, before + 1), found, is_found)
    missed = np.where(is_found[:, None], motions.missed(found), 0.0)
    own = np.linalg.inv(np.stack([c.information for c in seen.values()]))
    variances = motions.variances()[rows] + information_to_planar(own).diagonal(0, 1, 2)
    slips = np.sort(rows[np.sum(missed[rows] ** 2 / variances, axis=1) > OUTLIER])
    stamps = np.array([node.stamp_ns for node in nodes], np.int64)
    return WheelCheck(motions, len(seen), missed, slips, stamps)


def corrected(
    nodes: Sequence[Node], constraints: Sequence[Judged], check: WheelCheck
) -> list[Judged]:
    """The constraints; motions that wheels measured are calibrated by `check`.

    The model of wheels takes one motion's error to know nothing of the next one's. An error that
    all motions share adds up much faster where images measure none of them. A motion that images
    contradict is as uncertain as it is off.
    """
    motion_of = {node.id: k for k, node in enumerate(nodes)}
    measured = planar_to_matrix(check.motions.measured())
    slipped = np.zeros_like(check.missed)
    slipped[check.slips] = check.missed[check.slips]
    planar = np.eye(3) * (check.motions.variances() + slipped**2)[:, None]
    covariances = covariance_from_planar(planar, off_plane=_OUT_OF_PLANE)
    verdict = Verdict(Judge.CAMERA, False, Why.CORRECTED)

    def mended(c: Judged) -> Judged:
        k = motion_of[c.from_id]
        information = np.linalg.inv(covariances[k])
        return replace(c, i_from_j=measured[k], information=information, source=check.source)

    by_wheels = [isinstance(c.source, WHEELS) for c in constraints]
    return [
        *(c.judged(verdict) if of else c for c, of in zip(constraints, by_wheels, strict=True)),
        *(mended(c) for c, of in zip(constraints, by_wheels, strict=True) if of),
    ]
