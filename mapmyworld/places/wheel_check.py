"""Wheels checked by the camera: what images indicate about the motion between successive nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, make_transform
from mapmyworld.geometry.rotations import so3_exp, so3_log
from mapmyworld.kernels.wheel_model import FIRST_SIGMAS
from mapmyworld.odometry.tracking_losses import NAMED
from mapmyworld.types import (
    ConstraintKind,
    CorrectedOdometry,
    ImageMatch,
    Judge,
    Judged,
    Node,
    Verdict,
    Why,
)

_ENOUGH = 20  # motions from which a share can be reported
_SLIP_SIGMAS = 5.0  # robust sigmas beyond which wheels and images contradict each other
_BELIEVED = 0.02  # share up to which wheels are taken as reported: it adds up to less than slips do
_LEAST_TURN = 0.5  # rad in all, from which a share of it can be reported
_MEDIAN = 0.6745  # standard deviations that half of all stay within
_METRES_PER_RADIAN = FIRST_SIGMAS[5] / FIRST_SIGMAS[4]  # by as much the heading may err by either


@dataclass(frozen=True, slots=True)
class Slip:
    """A motion that wheels and images indicate differently."""

    stamp_ns: int
    """Of the later node."""
    metres: float
    radians: float


@dataclass(frozen=True, slots=True)
class WheelCheck:
    """How the recorded odometry compares with images."""

    motions: int
    """Between successive nodes, that images measured."""
    distance_share: float
    """By which images see more distance than the wheels; negative: less."""
    turn_share: float
    """By which images see more rotation; NaN where the robot hardly turned."""
    rad_per_m: float
    """By which images see the heading turn away with the distance, as of unequal wheels."""
    scatter_m: float
    scatter_rad: float
    """Robust standard deviations of a motion's difference, the shares taken out."""
    slips: tuple[Slip, ...]

    @property
    def is_far_off(self) -> bool:
        """Whether the same share is wrong in every motion by so much that it must be taken out."""
        shares = np.nan_to_num(
            [self.distance_share, self.turn_share, _METRES_PER_RADIAN * self.rad_per_m]
        )
        return bool(np.abs(shares).max() > _BELIEVED)

    def lines(self) -> tuple[str, ...]:
        """What a user should know."""
        turn = "" if np.isnan(self.turn_share) else f", rotation {self.turn_share:+.1%}"
        head = (
            f"recorded odometry against visual odometry over {self.motions} motions: distance "
            f"{self.distance_share:+.1%}{turn}, heading {np.degrees(self.rad_per_m):+.2f} deg "
            f"per m; scatter {1000 * self.scatter_m:.1f} mm, "
            f"{np.degrees(self.scatter_rad):.2f} deg; {len(self.slips)} contradictions"
        )
        taken = ["recorded odometry is corrected accordingly"] if self.is_far_off else []
        worst = sorted(self.slips, key=lambda s: -s.metres - s.radians)[:NAMED]
        slips = [
            f"at {s.stamp_ns * 1e-9:.2f} s recorded and visual odometry differ by "
            f"{s.metres:.3f} m, {np.degrees(s.radians):.1f} deg"
            for s in sorted(worst, key=lambda s: s.stamp_ns)
        ]
        return head, *slips, *taken


def check_wheels(nodes: Sequence[Node], constraints: Sequence[Judged]) -> WheelCheck | None:
    """The recorded odometry of `nodes` against image pairs; None where too few were matched."""
    place = {node.id: k for k, node in enumerate(nodes)}
    seen = [
        (c, (c.source.sigma_m, c.source.sigma_rad))
        for c in constraints
        if c.accepted and c.from_id in place and c.to_id in place
        if isinstance(c.source, ImageMatch) and c.source.steps == 1
    ]
    if len(seen) < _ENOUGH:
        return None
    ends = np.array([(place[c.from_id], place[c.to_id]) for c, _ in seen])
    odometry = np.stack([node.odom_from_base for node in nodes])
    wheels = between(odometry[ends[:, 0]], odometry[ends[:, 1]])
    images = np.stack([c.i_from_j for c, _ in seen])
    moved, seen_moved = wheels[:, :3, 3], images[:, :3, 3]
    turn, seen_turn = so3_log(wheels[:, :3, :3]), so3_log(images[:, :3, :3])
    bends = np.zeros_like(turn)
    bends[:, 2] = moved[:, 0]
    (distance,), along = _shares(moved[..., None], seen_moved - moved)
    (turned, rad_per_m), about = _shares(np.stack([turn, bends], axis=2), seen_turn - turn)
    if np.linalg.norm(turn, axis=1).sum() < _LEAST_TURN:
        turned = float("nan")
    apart, twisted = np.linalg.norm(along, axis=1), np.linalg.norm(about, axis=1)
    scatter = _spread(along), _spread(about)
    sigmas = np.hypot(scatter, [own for _, own in seen])
    bad = (np.column_stack([apart, twisted]) > _SLIP_SIGMAS * sigmas).any(axis=1)
    slips = tuple(
        Slip(nodes[ends[k, 1]].stamp_ns, float(apart[k]), float(twisted[k]))
        for k in np.flatnonzero(bad)
    )
    return WheelCheck(len(seen), distance, turned, rad_per_m, *scatter, slips)


def corrected(constraints: Sequence[Judged], check: WheelCheck) -> list[Judged]:
    """The constraints; motions that wheels measured are corrected by `check`.

    The model of wheels takes one motion's error to know nothing of the next one's. An error that
    all motions share adds up much faster where images measure none of them.
    """
    distance, turn = np.nan_to_num([check.distance_share, check.turn_share]).tolist()
    source = CorrectedOdometry(distance, turn, float(np.degrees(check.rad_per_m)))
    verdict = Verdict(Judge.CAMERA, False, Why.CORRECTED)

    def mended(motion: Array) -> Array:
        bent = np.array([0.0, 0.0, check.rad_per_m * motion[0, 3]])
        turned = so3_exp((1.0 + turn) * so3_log(motion[:3, :3]) + bent)
        return make_transform(turned, (1.0 + distance) * motion[:3, 3])

    motions = [c for c in constraints if c.kind is ConstraintKind.NEIGHBOUR]
    return [
        *(c.judged(verdict) if c.kind is ConstraintKind.NEIGHBOUR else c for c in constraints),
        *(replace(c, i_from_j=mended(c.i_from_j), source=source) for c in motions),
    ]


def _shares(reported: Array, off: Array) -> tuple[list[float], Array]:
    """Shares (K,) of vectors (N, 3, K) that add up to what motions are `off` by (N, 3), and what
    is left of that (N, 3). The nearer half counts in full, the others by their distance.
    """
    shares, left = np.zeros(reported.shape[2]), off
    for _ in range(10):
        length = np.linalg.norm(left, axis=1)
        weighed = reported / np.maximum(length, max(np.median(length), 1e-6))[:, None, None]
        normal = np.tensordot(weighed, reported, ([0, 1], [0, 1]))
        shares = np.linalg.lstsq(normal, np.tensordot(weighed, off, ([0, 1], [0, 1])))[0]
        left = off - reported @ shares
    return shares.tolist(), left


def _spread(vectors: Array) -> float:
    """Robust standard deviation of vectors (N, 3) along the axis in which they differ most."""
    return float(np.median(np.abs(vectors), axis=0).max() / _MEDIAN)
