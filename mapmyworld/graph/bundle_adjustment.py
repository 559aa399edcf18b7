"""Bundle adjustment: cameras and the points they saw, together, in the least-squares sense.

Levenberg-Marquardt with the points eliminated (Schur complement; Triggs et al., "Bundle
adjustment - a modern synthesis", 2000). Own linear algebra instead of gtsam's, since a window of
ten images must be solved in some hundredths of a second.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between, se3_adjoint, se3_exp, se3_log
from mapmyworld.kernels.bundle import (
    bundle_normal_equations,
    eliminate_points,
    move_points,
    subtract_gradients,
    subtract_points,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class RelativePoses:
    """Measured motions between cameras: odometry, or registrations worth keeping."""

    first: Indices
    """(R,) indices of cameras."""
    second: Indices
    """(R,) indices of cameras."""
    first_from_second: Array
    """(R, 4, 4)."""
    information: Array
    """(R, 6, 6), rotation first."""


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """K cameras, P points, and M observations sorted by point."""

    cameras: Array
    """(K, 4, 4) map_from_camera."""
    fixed: NDArray[np.bool_]
    """(K,) cameras that stay where they are; at least one."""
    points: Array
    """(P, 3) metres, map frame."""
    camera_of: Indices
    """(M,)."""
    point_of: Indices
    """(M,) ascending."""
    seen: Array
    """(M, 3): x, y at depth 1, inverse depth in 1/m or NaN."""
    sigmas: Array
    """(M, k) standard deviations of x and y, and of the inverse depth in 1/m; k is 2 or more."""
    motions: RelativePoses | None = None


def adjust_bundle(bundle: Bundle, *, rounds: int = 10, width: float = 2.0) -> tuple[Bundle, float]:
    """The bundle with cameras and points of least robust cost, and that cost.

    Stops when the cost falls by less than a thousandth; a step that raises it is taken back and
    tried shorter, so the cost never grows.
    """
    damping = 1e-4
    blocks, cost = linearise(bundle, width)
    for _ in range(rounds):
        trial = _step(bundle, blocks, damping)
        if trial is None:
            break
        trial_blocks, trial_cost = linearise(trial, width)
        if trial_cost > cost:
            damping *= 10.0
            continue
        done = cost - trial_cost < 1e-3 * cost
        bundle, blocks, cost, damping = trial, trial_blocks, trial_cost, damping * 0.3
        if done:
            break
    return bundle, cost


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """A bundle's normal equations, camera by camera, point by point, sighting by sighting."""

    cameras: Array
    """(K, 6, 6)."""
    camera_gradients: Array
    """(K, 6), rotation first."""
    points: Array
    """(P, 3, 3)."""
    point_gradients: Array
    """(P, 3)."""
    cross: Array
    """(M, 6, 3) of every sighting's camera and point."""
    motions: tuple[Array, Array, Array, Array, Array] | None
    """Blocks aa, bb, ba (R, 6, 6) and gradients a, b (R, 6) of motions between cameras."""


def linearise(bundle: Bundle, width: float) -> tuple[Blocks, float]:
    """The normal equations at the bundle, and its robust cost with Huber's weights."""
    k, p, m = len(bundle.cameras), len(bundle.points), len(bundle.camera_of)
    cameras, camera_gradients = np.zeros((k, 6, 6)), np.zeros((k, 6))
    points, point_gradients = np.zeros((p, 3, 3)), np.zeros((p, 3))
    cross = np.zeros((m, 6, 3))
    cost = bundle_normal_equations(
        bundle.cameras,
        bundle.points,
        bundle.camera_of,
        bundle.point_of,
        bundle.seen,
        bundle.sigmas,
        width,
        cameras,
        camera_gradients,
        points,
        point_gradients,
        cross,
    )
    motions = None
    if bundle.motions is not None and len(bundle.motions.first):
        motions, motion_cost = _linearise_motions(bundle.cameras, bundle.motions)
        cost += motion_cost
    return Blocks(cameras, camera_gradients, points, point_gradients, cross, motions), cost


def _linearise_motions(
    cameras: Array, motions: RelativePoses
) -> tuple[tuple[Array, Array, Array, Array, Array], float]:
    """Blocks aa, bb, ba and gradients a, b of every motion, and their cost.

    The residual is log(measured^-1 a^-1 b); its Jacobians are taken as -Ad(b^-1 a) and 1, right
    for small residuals.
    """
    measured = motions.first_from_second
    now = between(cameras[motions.first], cameras[motions.second])
    residual = se3_log(between(measured, now))
    first = -se3_adjoint(np.linalg.inv(now))
    information = motions.information
    weighted = np.einsum("rij,rj->ri", information, residual)
    ta = np.swapaxes(first, 1, 2)
    blocks = (
        ta @ information @ first,
        information,
        information @ first,
        np.einsum("rij,rj->ri", ta, weighted),
        weighted,
    )
    return blocks, float(np.sum(residual * weighted))


def _step(bundle: Bundle, blocks: Blocks, damping: float) -> Bundle | None:
    """The bundle after one damped step; None where the equations have no solution."""
    slots = free_slots(bundle)
    free = np.flatnonzero(~bundle.fixed)
    scaled, inverse = eliminated(bundle, blocks, damping)
    reduced, gradient = _camera_equations(bundle, blocks, slots, free, damping)
    slot_of = slots[bundle.camera_of]
    subtract_points(starts_of_points(bundle), slot_of, blocks.cross, scaled, reduced)
    explain(bundle, blocks, scaled, slot_of, gradient.reshape(-1, 6))
    try:
        factor = scipy.linalg.cho_factor(reduced, lower=True, overwrite_a=True, check_finite=False)
    except scipy.linalg.LinAlgError:
        return None
    tangents = np.zeros((len(bundle.cameras), 6))
    tangents[free] = -scipy.linalg.cho_solve(factor, gradient, check_finite=False).reshape(-1, 6)
    points = moved_points(bundle, blocks, inverse, tangents)
    return replace(bundle, cameras=bundle.cameras @ se3_exp(tangents), points=points)


def free_slots(bundle: Bundle) -> Indices:
    """(K,) number of every camera among the free ones, -1 for fixed ones."""
    return np.where(bundle.fixed, -1, np.cumsum(~bundle.fixed) - 1).astype(np.int64)


def starts_of_points(bundle: Bundle) -> Indices:
    """(P + 1,) where each point's observations begin."""
    found = np.searchsorted(bundle.point_of, np.arange(len(bundle.points) + 1))
    return np.asarray(found, np.int64)


def eliminated(bundle: Bundle, blocks: Blocks, damping: float) -> tuple[Array, Array]:
    """Cross blocks (M, 6, 3) times their point's damped block's inverse, and these (P, 3, 3)."""
    scaled, inverse = np.empty_like(blocks.cross), np.empty_like(blocks.points)
    eliminate_points(blocks.points, damping, blocks.cross, bundle.point_of, inverse, scaled)
    return scaled, inverse


def explain(
    bundle: Bundle, blocks: Blocks, scaled: Array, slot_of: Indices, gradient: Array
) -> None:
    """Subtracts from the free cameras' `gradient` (F, 6) what the points explain.

    By `scaled` (M, 6, 3) as of `eliminated`; `slot_of` (M,) is the camera's, as of `free_slots`.
    """
    subtract_gradients(scaled, blocks.point_gradients, bundle.point_of, slot_of, gradient)


def moved_points(bundle: Bundle, blocks: Blocks, inverse: Array, tangents: Array) -> Array:
    """The points (P, 3) that fit best once the cameras have moved by tangents (K, 6).

    `inverse` (P, 3, 3) as of `eliminated`.
    """
    right, points = blocks.point_gradients.copy(), np.array(bundle.points)
    move_points(inverse, blocks.cross, tangents, bundle.camera_of, bundle.point_of, right, points)
    return points


def _camera_equations(
    bundle: Bundle, blocks: Blocks, slots: Indices, free: Indices, damping: float
) -> tuple[Array, Array]:
    """Matrix (6F, 6F) and gradient (6F,) of the free cameras, before the points are eliminated."""
    count = len(free)
    reduced = np.zeros((count, 6, count, 6))
    own = blocks.cameras[free]
    own = own + damping * own * np.eye(6) + 1e-6 * np.eye(6)
    reduced[np.arange(count), :, np.arange(count)] = own
    gradient = blocks.camera_gradients[free].copy()
    if blocks.motions is not None and bundle.motions is not None:
        first, second = slots[bundle.motions.first], slots[bundle.motions.second]
        aa, bb, ba, ga, gb = blocks.motions
        for r, (a, b) in enumerate(zip(first, second, strict=True)):
            if a >= 0:
                reduced[a, :, a] += aa[r]
                gradient[a] += ga[r]
            if b >= 0:
                reduced[b, :, b] += bb[r]
                gradient[b] += gb[r]
            if a >= 0 and b >= 0:
                reduced[b, :, a] += ba[r]
                reduced[a, :, b] += ba[r].T
    return reduced.reshape(6 * count, 6 * count), gradient.reshape(-1)
