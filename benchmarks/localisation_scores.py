"""How localised moments are judged: one row of a table."""

from __future__ import annotations

import numpy as np

from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory
from mapmyworld.types.localisation import Localisation, State

_FAR = 0.5  # m: a pose that is claimed and farther off is false
_PLANAR = np.array([3, 4, 2])  # x, y, yaw of a rotation-first tangent


def report(name: str, found: Localisation, cpu_s: float, reference: Trajectory) -> None:
    """One row: how much was claimed, how right it was, and its cost."""
    stamps = np.array([e.stamp_ns for e in found.estimates])
    poses = np.stack([e.map_from_base for e in found.estimates])
    claimed = np.array([e.state != State.LOST for e in found.estimates])
    off = between(poses, poses_at(reference, stamps))
    if not claimed.any():
        print(f"| {name} | never | 0 % |", flush=True)
        return
    metres = np.linalg.norm(off[:, :2, 3], axis=1)[claimed]
    degrees = np.degrees(rotation_angle(off))[claimed]
    squares = normalised_squares(found, off)[claimed]
    duration = (stamps.max() - stamps.min()) * 1e-9
    first = found.recognised_after_s
    print(
        f"| {name} | {'never' if first is None else f'{first:.1f}'} | {claimed.mean():.1%} | "
        f"{np.median(metres):.4f} | {np.percentile(metres, 95):.4f} | {metres.max():.3f} | "
        f"{np.median(degrees):.2f} | {np.count_nonzero(metres > _FAR)} | {found.times_lost} | "
        f"{squares.mean():.2f} | {np.percentile(squares, 95):.2f} | {duration / cpu_s:.0f} |",
        flush=True,
    )


def head() -> None:
    columns = ("log in map", "found after s", "claimed", "median m", "95 % m", "max m",
               "median deg", "false", "lost again", "NEES mean", "NEES 95 %",
               "x real time")  # fmt: skip
    print(f"| {' | '.join(columns)} |")
    print(f"|{' --- |' * len(columns)}")


def normalised_squares(found: Localisation, off: np.ndarray) -> np.ndarray:
    """Squared error (N,) over its covariance (NEES), of x, y and yaw: 3 on average if both fit."""
    error = matrix_to_planar(off)
    spread = np.stack([e.covariance[np.ix_(_PLANAR, _PLANAR)] for e in found.estimates])
    return np.einsum("ki,kij,kj->k", error, np.linalg.inv(spread), error)


def show_kidnapping(found: Localisation, truth: Trajectory) -> None:
    """When the robot was carried, when that was noticed, and when its place was found again."""
    steps = np.linalg.norm(np.diff(truth.poses[:, :2, 3], axis=0), axis=1)
    carried = int(truth.stamps_ns[int(np.argmax(steps)) + 1])
    after = [e for e in found.estimates if e.stamp_ns >= carried - 150_000_000]
    lost = next((e.stamp_ns for e in after if e.state == State.LOST), None)
    if lost is None:
        print("  not noticed")
        return
    again = next((e.stamp_ns for e in after if e.stamp_ns > lost and e.state != State.LOST), None)
    back = "never" if again is None else f"{(again - carried) * 1e-9:.1f} s"
    print(f"  noticed after {max(lost - carried, 0) * 1e-9:.1f} s, found again after {back}")
