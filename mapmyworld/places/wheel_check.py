"""Wheels checked by the camera: what images indicate about the motion between successive nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, make_transform
from mapmyworld.geometry.rotations import so3_exp, so3_log
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
    scatter_m: float
    scatter_rad: float
    """Robust standard deviations of a motion's difference, the shares taken out."""
    slips: tuple[Slip, ...]

    @property
    def is_far_off(self) -> bool:
        """Whether the same share is wrong in every motion by so much that it must be taken out."""
        shares = np.nan_to_num([self.distance_share, self.turn_share])
        return bool(np.abs(shares).max() > _BELIEVED)

    def lines(self) -> tuple[str, ...]:
        """What a user should know."""
        turn = "" if np.isnan(self.turn_share) else f", rotation {self.turn_share:+.1%}"
        head = (
            f"recorded odometry against visual odometry over {self.motions} motions: distance "
            f"{self.distance_share:+.1%}{turn}; scatter {1000 * self.scatter_m:.1f} mm, "
            f"{np.degrees(self.scatter_rad):.2f} deg; {len(self.slips)} contradictions"
        )
        taken = ["recorded odometry is scaled by these shares"] if self.is_far_off else []
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
    distance, turned = _ratio(moved, seen_moved), _ratio(turn, seen_turn)
    apart = np.linalg.norm(seen_moved - distance * moved, axis=1)
    twisted = np.linalg.norm(seen_turn - (1.0 if np.isnan(turned) else turned) * turn, axis=1)
    scatter = _spread(apart), _spread(twisted)
    sigmas = np.hypot(scatter, [own for _, own in seen])
    bad = (np.column_stack([apart, twisted]) > _SLIP_SIGMAS * sigmas).any(axis=1)
    slips = tuple(
        Slip(nodes[ends[k, 1]].stamp_ns, float(apart[k]), float(twisted[k]))
        for k in np.flatnonzero(bad)
    )
    return WheelCheck(len(seen), distance - 1.0, turned - 1.0, *scatter, slips)


def corrected(constraints: Sequence[Judged], check: WheelCheck) -> list[Judged]:
    """The constraints; motions that wheels measured are scaled by the shares of `check`.

    The model of wheels takes one motion's error to know nothing of the next one's. An error that
    all motions share adds up much faster where images measure none of them.
    """
    distance, turn = np.nan_to_num([check.distance_share, check.turn_share]).tolist()
    source = CorrectedOdometry(distance, turn)
    verdict = Verdict(Judge.CAMERA, False, Why.CORRECTED)

    def mended(motion: Array) -> Array:
        turned = so3_exp((1.0 + turn) * so3_log(motion[:3, :3]))
        return make_transform(turned, (1.0 + distance) * motion[:3, 3])

    motions = [c for c in constraints if c.kind is ConstraintKind.NEIGHBOUR]
    return [
        *(c.judged(verdict) if c.kind is ConstraintKind.NEIGHBOUR else c for c in constraints),
        *(replace(c, i_from_j=mended(c.i_from_j), source=source) for c in motions),
    ]


def _ratio(reported: Array, seen: Array) -> float:
    """The factor that takes vectors (N, 3) reported by wheels to those seen; NaN for hardly any."""
    length = np.linalg.norm(reported, axis=1)
    if length.sum() < 0.5:  # m or rad
        return float("nan")
    factor = 1.0
    for _ in range(5):
        off = np.linalg.norm(seen - factor * reported, axis=1)
        weight = 1.0 / np.maximum(off, max(_spread(off), 1e-6))
        factor = float(np.sum(weight[:, None] * reported * seen) / np.sum(weight * length**2))
    return factor


def _spread(lengths: Array) -> float:
    """Robust standard deviation along an axis, of vectors of these lengths (Rayleigh's median)."""
    return float(np.median(lengths) / np.sqrt(2.0 * np.log(2.0)))
