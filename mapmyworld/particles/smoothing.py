"""The best particle's path and map, refined in turn.

A particle fixes each pose when it passes, with the map of that moment. Offline the whole path is
known, so the posterior over paths, p(x_1:t, m | z_1:t, u_1:t), can be climbed on: given the
map, a Gauss-Newton step for all poses at once (scans are independent given map and poses, motions
tie neighbours only, so the system is banded); given the poses, the map anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from mapmyworld.config.particles_settings import ParticlesConfig
from mapmyworld.geometry.planar import between_planar, wrap_angle
from mapmyworld.particles import kernels
from mapmyworld.particles.kernels import Beams
from mapmyworld.particles.threads import Workers
from mapmyworld.particles.tiles import TileMaps
from mapmyworld.types import Progress

_REACH = 3  # cells searched around an end point
_ANCHOR = 1e8  # information that holds the first pose


def smooth_path(
    path: NDArray[np.float64],
    motions: NDArray[np.float64],
    information: NDArray[np.float64],
    scans: Sequence[Beams],
    config: ParticlesConfig,
    workers: Workers,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """The refined path (K, 3) of scans whose motions (K - 1, 3) are known to `information`."""
    points = np.concatenate([scan.points for scan in scans])
    normals = np.concatenate([scan.normals for scan in scans])
    sizes = np.array([len(scan.points) for scan in scans])
    ends = np.concatenate([[0], np.cumsum(sizes)])
    scale = np.minimum(1.0, config.beams_effective / np.maximum(sizes, 1))
    path = path.copy()
    for done in range(config.smoothing):
        if progress is not None:
            progress.update(done)
        maps = TileMaps(1, config.resolution, workers)
        maps.insert_path(points, normals, ends, path)
        H, g = np.zeros((len(path), 3, 3)), np.zeros((len(path), 3))
        share = np.zeros(len(path))
        workers.run_maps(
            kernels.linearise_path,
            maps.surfaces,
            len(path),
            (points, normals, ends, path, _REACH, config.sigma, H, g, share),
        )
        H, g = H * scale[:, None, None], g * scale[:, None]
        step = _banded_step(path, motions, information, H, g)
        path += step
        path[:, 2] = wrap_angle(path[:, 2])
        if np.max(np.abs(step)) < 1e-4:
            break
    return path


def _banded_step(
    path: NDArray[np.float64],
    motions: NDArray[np.float64],
    information: NDArray[np.float64],
    H: NDArray[np.float64],
    g: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The Gauss-Newton step (K, 3) of scans (H, g) and motions together."""
    count = len(path)
    A, B = _motion_jacobians(path)
    error = between_planar(path[:-1], path[1:]) - motions
    error[:, 2] = wrap_angle(error[:, 2])
    diagonal, right = H.copy(), g.copy()
    diagonal[0] += _ANCHOR * np.eye(3)
    AtI, BtI = np.swapaxes(A, 1, 2) @ information, np.swapaxes(B, 1, 2) @ information
    diagonal[:-1] += AtI @ A
    diagonal[1:] += BtI @ B
    right[:-1] += np.einsum("kij,kj->ki", AtI, error)
    right[1:] += np.einsum("kij,kj->ki", BtI, error)
    band = np.zeros((6, 3 * count))
    coupling = AtI @ B
    for i in range(3):
        for j in range(3):
            if j >= i:
                band[5 + i - j, j::3] = diagonal[:, i, j]
            band[2 + i - j, 3 + j :: 3] = coupling[:, i, j]
    return np.asarray(-solveh_banded(band, right.ravel()).reshape(count, 3))


def _motion_jacobians(
    path: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives (K - 1, 3, 3) of `a_from_b` by increments of a and of b in the map frame."""
    cos, sin = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    dx, dy = np.diff(path[:, 0]), np.diff(path[:, 1])
    B = np.zeros((len(path) - 1, 3, 3))
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = cos, sin, -sin, cos, 1.0
    A = -B
    A[:, 0, 2] = -sin * dx + cos * dy
    A[:, 1, 2] = -cos * dx - sin * dy
    return A, B
