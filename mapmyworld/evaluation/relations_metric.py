"""The relations metric: errors of relative poses between known moments.

Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27(4), 2009.
Cartographer's tables (Hess et al., ICRA 2016) use the error's inverse order, in which an error of
rotation also moves the translation; that figure is given beside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.evaluation.association import nearest_stamps
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, interpolate, invert
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory
from mapmyworld.types.maps import Relations

FEW = 0.5  # share of the relations below which a score says little of the whole drive
_SAME_STAMP_NS = 500  # two stamps written with six decimals are the same within half a unit


@dataclass(frozen=True, slots=True)
class MeanStd:
    """A mean and its sample's standard deviation."""

    mean: float
    std: float
    """Of the sample (divided by the count less one), as in the papers' tables."""


@dataclass(frozen=True, slots=True, eq=False)
class RelationsScore:
    """Errors of an estimated trajectory against known relative poses."""

    count: int
    """Relations that are scored: those of which the trajectory covers both moments."""
    translation: MeanStd
    """Metres, of `expected^-1 * measured`."""
    rotation_deg: MeanStd
    squared_translation: MeanStd
    """Square metres."""
    squared_rotation_deg: MeanStd
    cartographer_translation: MeanStd
    """Metres, of `measured * expected^-1`."""
    covered: NDArray[np.bool_]
    """(M,) which of all relations are scored."""
    translation_errors: Array
    """(N,) metres, of those that are scored."""

    @property
    def outside(self) -> int:
        """Relations of which a moment lies outside the trajectory's time, which are not scored."""
        return len(self.covered) - self.count

    @property
    def share(self) -> float:
        """Of all relations that are scored, 0 to 1."""
        return self.count / len(self.covered)


def relations_score(trajectory: Trajectory, relations: Relations) -> RelationsScore:
    """How well a trajectory fits the known relative poses of its time.

    Raises `MapError` where either is empty, or none is of its time.
    """
    if len(trajectory.stamps_ns) == 0 or len(relations.stamps_ns) == 0:
        raise MapError("the relations metric needs a trajectory with poses and some relations")
    covered = _covered(trajectory, relations)
    relations = Relations(relations.stamps_ns[covered], relations.first_from_second[covered])
    map_from_first = poses_at(trajectory, relations.stamps_ns[:, 0])
    map_from_second = poses_at(trajectory, relations.stamps_ns[:, 1])
    measured = between(map_from_first, map_from_second)
    error = between(relations.first_from_second, measured)
    other = measured @ invert(relations.first_from_second)
    translation = np.linalg.norm(error[:, :3, 3], axis=1)
    rotation = np.degrees(rotation_angle(error))
    return RelationsScore(
        count=len(translation),
        translation=_mean_std(translation),
        rotation_deg=_mean_std(rotation),
        squared_translation=_mean_std(translation**2),
        squared_rotation_deg=_mean_std(rotation**2),
        cartographer_translation=_mean_std(np.linalg.norm(other[:, :3, 3], axis=1)),
        covered=covered,
        translation_errors=translation,
    )


def _covered(trajectory: Trajectory, relations: Relations) -> NDArray[np.bool_]:
    """(N,) the relations whose moments both lie within the trajectory's time."""
    first, last = int(trajectory.stamps_ns.min()), int(trajectory.stamps_ns.max())
    since, until = first - _SAME_STAMP_NS, last + _SAME_STAMP_NS
    inside = (relations.stamps_ns >= since) & (relations.stamps_ns <= until)
    covered = np.asarray(inside.all(axis=1))
    if not covered.any():
        moments = relations.stamps_ns
        raise MapError(
            f"none of {len(moments)} relations lies in the trajectory's time, {first * 1e-9:.3f} "
            f"to {last * 1e-9:.3f} s: theirs is {moments.min() * 1e-9:.3f} to "
            f"{moments.max() * 1e-9:.3f} s: give those of the same log"
        )
    return covered


def poses_at(trajectory: Trajectory, stamps_ns: NDArray[np.int64]) -> Array:
    """Poses (N, 4, 4) at the stamps (N,): recorded where one is stamped so, else interpolated.

    Beyond the ends it is the end pose. Stamps that step back (as in logs with a disordered clock)
    are harmless where a pose has the very stamp; else its neighbours in time are used.
    """
    nearest = nearest_stamps(trajectory.stamps_ns, stamps_ns)
    exact = np.abs(trajectory.stamps_ns[nearest] - stamps_ns) <= _SAME_STAMP_NS
    order = np.argsort(trajectory.stamps_ns, kind="stable")
    ordered, poses = trajectory.stamps_ns[order], trajectory.poses[order]
    if len(ordered) == 1:
        return np.repeat(poses, len(stamps_ns), axis=0)
    after = np.clip(np.searchsorted(ordered, stamps_ns), 1, len(ordered) - 1)
    gap = np.maximum(ordered[after] - ordered[after - 1], 1)
    fraction = np.clip((stamps_ns - ordered[after - 1]) / gap, 0.0, 1.0)
    between_two = interpolate(poses[after - 1], poses[after], fraction)
    return np.where(exact[:, None, None], trajectory.poses[nearest], between_two)


def _mean_std(errors: Array) -> MeanStd:
    return MeanStd(float(errors.mean()), float(errors.std(ddof=1)) if len(errors) > 1 else 0.0)
