"""Constraints as gtsam's factors, in bulk; nodes are keys by their position.

A node that stays is no variable: an edge from it is a prior of the other end, which is the same
residual. So nothing has to hold it with a weight, and every factor counts as it was stated.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from mapmyworld.backend.landmarks import POLAR, sighting_derivatives, sighting_residuals
from mapmyworld.backend.system import Objects, System, chosen_edges, moving_edges
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import compose_planar, invert_planar, planar_adjoint
from mapmyworld.geometry.rigid import invert, se3_adjoint


@dataclass(frozen=True, slots=True, eq=False)
class FactorGraph:
    """gtsam's graph of a system and values to begin with.

    Whoever knows more of the poses adds factors and variables of any kind to both: variables under
    keys of gtsam's symbols, which come after all nodes. `descent.solved` and
    `information.Information` take them as they come.
    """

    factors: Any
    """gtsam.NonlinearFactorGraph."""
    values: Any
    """gtsam.Values."""

    def at(self, system: System, poses: Array) -> FactorGraph:
        """The graph of the same system at other poses (N, 3 or 4, 4), map_from_node."""
        if system.kinds is not None:  # sightings are linear about the poses
            return factor_graph(system, poses)
        return FactorGraph(self.factors, _values(system, poses))


def elimination_order(factors: Any) -> list[int]:
    """All keys of gtsam's factors in METIS's order; METIS itself breaks down on variables that no
    factor links to another, so these come first.
    """
    every = [factors.at(k) for k in range(factors.size())]
    keys = [factor.keys() for factor in every]
    linked = {key for some in keys if len(some) > 1 for key in some}
    alone = sorted({key for some in keys for key in some} - linked)
    if not linked:
        return alone
    if alone:
        factors = _graph(f for f, some in zip(every, keys, strict=True) if len(some) > 1)
    order = gtsam.Ordering.MetisNonlinearFactorGraph(factors)
    return [*alone, *(order.at(k) for k in range(order.size()))]


def factor_graph(system: System, poses: Array) -> FactorGraph:
    """The factors of all edges that a free node has, in their order, and all free nodes.

    These start at `poses` (N, 3 or 4, 4), map_from_node.
    """
    values = _values(system, poses)
    return FactorGraph(factors_at(system, poses, values), values)


def factors_at(system: System, poses: Array, values: Any) -> Any:
    """Gtsam's graph of the edges that have a free end, in their order.

    `poses` (N, 3 or 4, 4) are map_from_node of all nodes, `values` gtsam's of the free ones.
    """
    system = _from_held_nodes(chosen_edges(system, moving_edges(system)))
    seen = np.zeros(len(system.tails), np.bool_) if system.kinds is None else system.kinds > 0
    held = (system.free[system.tails] < 0) & ~seen
    found = np.empty(len(seen), np.object_) if system.factors is None else system.factors
    if system.factors is None:
        plain = ~(held | seen)
        found[plain] = between_factors(chosen_edges(system, plain))
    found[held] = _priors(chosen_edges(system, held), poses)
    if seen.any():
        sightings = _sightings(chosen_edges(system, seen), poses, values)
        found[seen] = np.fromiter(sightings, np.object_)
    return _graph(found.tolist())


def _graph(factors: Iterable[Any]) -> Any:
    """Gtsam's of these factors."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph


def _from_held_nodes(system: System) -> System:
    """The same edges, those into a node that stays turned around: `r' = -Ad(measured) r`."""
    into = (system.free[system.heads] < 0) & (system.free[system.tails] >= 0)
    if system.kinds is not None:
        into &= system.kinds == 0
    return turned(system, into) if into.any() else system


def turned(system: System, which: NDArray[np.bool_]) -> System:
    """The system with these edges (E,) leading from their heads to their tails."""
    measured, information = system.measured.copy(), system.information.copy()
    back = (invert_planar if system.planar else invert)(measured[which])
    adjoint = (planar_adjoint if system.planar else se3_adjoint)(back)
    measured[which] = back
    information[which] = np.swapaxes(adjoint, 1, 2) @ information[which] @ adjoint
    tails, heads = system.tails.copy(), system.heads.copy()
    tails[which], heads[which] = system.heads[which], system.tails[which]
    return replace(system, tails=tails, heads=heads, measured=measured, information=information)


def between_factors(system: System) -> Objects:
    """(E,) factors of edges between free nodes."""
    make = gtsam.BetweenFactorPose2 if system.planar else gtsam.BetweenFactorPose3
    ends = system.tails.tolist(), system.heads.tolist()
    stated = _poses(system.planar, system.measured), map(_noise, system.information)
    return np.fromiter(map(make, *ends, *stated), np.object_, len(system.tails))


def _priors(system: System, poses: Array) -> Objects:
    """(E,) factors of edges from nodes that stay: where each wants its head."""
    make = gtsam.PriorFactorPose2 if system.planar else gtsam.PriorFactorPose3
    onward = compose_planar if system.planar else np.matmul
    wanted = _poses(system.planar, onward(poses[system.tails], system.measured))
    rows = map(make, system.heads.tolist(), wanted, map(_noise, system.information))
    return np.fromiter(rows, np.object_, len(system.tails))


def _poses(planar: bool, poses: Array) -> Iterator[Any]:
    """Gtsam's of poses (N, 3 or 4, 4)."""
    return map(gtsam.Pose2, *poses.T.tolist()) if planar else map(gtsam.Pose3, poses)


_noise = gtsam.noiseModel.Gaussian.Information


def _sightings(system: System, poses: Array, values: Any) -> Iterator[Any]:
    """The factors of a system's sightings, in their order.

    gtsam has none for a position, nor for what a node sees that stays: these are linear about
    `poses` (N, 3 or 4, 4), where their errors and derivatives are those of the sighting. `values`
    are gtsam's of the free nodes.
    """
    planar, kinds = system.planar, system.kinds
    assert kinds is not None
    ends = poses[system.tails], poses[system.heads]
    shift, unit = (slice(0, 2), _UNIT[2]) if planar else (slice(3, 6), _UNIT[3])
    root = _roots(system.information[:, shift, shift])
    errors = sighting_residuals(planar, *ends, system.measured, kinds)[:, shift, None]
    by_node, by_point = sighting_derivatives(planar, *ends, kinds)
    rows = zip(system.tails.tolist(), system.heads.tolist(), system.free[system.tails] < 0,
               kinds == POLAR, system.measured, system.information[:, shift, shift],
               root @ by_node, root @ by_point, -(root @ errors), strict=True)  # fmt: skip
    for tail, head, held, polar, measured, information, node, point, right in rows:
        if polar and not held:
            bearing, noise = gtsam.Rot2(measured[0]), _noise(information)
            yield gtsam.BearingRangeFactor2D(tail, head, bearing, measured[1], noise)
        else:
            known = (head, point) if held else (tail, node, head, point)
            yield gtsam.LinearContainerFactor(gtsam.JacobianFactor(*known, right, unit), values)


_UNIT = {size: gtsam.noiseModel.Unit.Create(size) for size in (2, 3)}


def _roots(information: Array) -> Array:
    """Matrices W (K, d, d) of which each `W' W` is the information, (K, d, d) too."""
    values, axes = np.linalg.eigh(information)
    roots = np.sqrt(np.maximum(values, 0.0))
    return np.asarray(roots[:, :, None] * np.swapaxes(axes, 1, 2))


def _values(system: System, poses: Array) -> Any:
    """Gtsam's values of all free nodes. `poses` (N, 3 or 4, 4), map_from_node, are of all nodes."""
    values, is_point = gtsam.Values(), system.points
    free = system.free >= 0
    nodes = np.flatnonzero(free & ~is_point)
    for key, pose in zip(nodes.tolist(), _poses(system.planar, poses[nodes]), strict=True):
        values.insert(key, pose)
    places = poses[:, :2] if system.planar else poses[:, :3, 3]
    for key in np.flatnonzero(free & is_point).tolist():
        values.insert(key, places[key])
    return values


def poses_of(system: System, values: Any, poses: Array) -> Array:
    """The poses (N, 3 or 4, 4), with what gtsam found for free nodes, in the same shape."""
    found, is_point, free = poses.copy(), system.points, system.free >= 0
    nodes, points = np.flatnonzero(free & ~is_point), np.flatnonzero(free & is_point)
    if system.planar:
        found[nodes] = gtsam.utilities.extractPose2(values)[: len(nodes)]
        if len(points):
            found[points, :2] = gtsam.utilities.extractPoint2(values)[: len(points)]
        return found
    rows = gtsam.utilities.extractPose3(values)[: len(nodes)]
    found[nodes, :3, :3], found[nodes, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    if len(points):
        found[points, :3, 3] = gtsam.utilities.extractPoint3(values)[: len(points)]
    return found
