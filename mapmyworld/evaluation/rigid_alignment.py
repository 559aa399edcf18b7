"""The rigid motion that brings one set of points nearest to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_RANK_TOLERANCE = 1e-12  # of a singular value, relative to the largest, to count as zero


def rigid_alignment(a_points: ArrayLike, b_points: ArrayLike) -> NDArray[np.float64]:
    """`a_from_b` (D+1, D+1) that minimises the squared distances of paired points, (N, D) both.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 13(4), 1991, equations 34 to 43 with scale 1. Points in three dimensions that all lie on
    one line leave the rotation about it open: then only x and y are aligned, if that is possible
    (a robot that drove straight), else any of the best rotations is taken.
    """
    a, b = np.asarray(a_points, np.float64), np.asarray(b_points, np.float64)
    dimension = a.shape[1]
    left, singular, right = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)) / len(a))
    on_a_line = np.count_nonzero(singular > _RANK_TOLERANCE * max(singular[0], 1e-300)) < 2
    if dimension == 3 and on_a_line:
        return _planar_alignment(a, b)
    signs = np.ones(dimension)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotation = (left * signs) @ right
    motion = np.eye(dimension + 1)
    motion[:-1, :-1] = rotation
    motion[:-1, -1] = a.mean(0) - rotation @ b.mean(0)
    return motion


def _planar_alignment(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    planar = rigid_alignment(a[:, :2], b[:, :2])
    motion = np.eye(4)
    motion[:2, :2], motion[:2, 3] = planar[:2, :2], planar[:2, 2]
    motion[2, 3] = a[:, 2].mean() - b[:, 2].mean()
    return motion
