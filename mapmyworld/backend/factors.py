"""Constraints as gtsam's factors, in bulk; nodes are keys by their position.

A node that stays is no variable: an edge from it is a prior of the other end, which is the same
residual. So nothing has to hold it with a weight, and every factor counts as it was stated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np

from mapmyworld.backend.landmarks import POINT, sighting_derivatives
from mapmyworld.backend.system import System, chosen_edges, moving_edges
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


def elimination_order(factors: Any) -> list[int]:
    """All keys of gtsam's factors in METIS's order; METIS itself breaks down on variables that no
    factor links to another, so these come first.
    """
    keys = [factors.at(k).keys() for k in range(factors.size())]
    linked = {key for some in keys if len(some) > 1 for key in some}
    alone = sorted({key for some in keys for key in some} - linked)
    if alone:
        among = gtsam.NonlinearFactorGraph()
        for k, some in enumerate(keys):
            if len(some) > 1:
                among.push_back(factors.at(k))
        factors = among
    if not linked:
        return alone
    order = gtsam.Ordering.MetisNonlinearFactorGraph(factors)
    return [*alone, *(order.at(k) for k in range(order.size()))]


def factor_graph(system: System, poses: Array) -> FactorGraph:
    """The factors of all edges that a free node has, in their order, and all free nodes.

    These start at `poses` (N, 3 or 4, 4), map_from_node.
    """
    return FactorGraph(factors_of(system, poses), values_of(system, poses))


def factors_of(system: System, poses: Array) -> Any:
    """Gtsam's graph of the edges that have a free end, in their order.

    `poses` (N, 3 or 4, 4) are map_from_node of all nodes.
    """
    system = _from_held_nodes(chosen_edges(system, moving_edges(system)))
    factors = gtsam.NonlinearFactorGraph()
    kinds = np.zeros(len(system.tails), np.int64) if system.kinds is None else system.kinds
    make = _Maker.of(system.planar)
    tails, heads, starts = system.tails, system.heads, _targets(system, poses)
    stays = system.free[tails] < 0
    rows = zip(tails.tolist(), heads.tolist(), system.measured, system.information,
               kinds.tolist(), stays.tolist(), starts, strict=True)  # fmt: skip
    for tail, head, measured, information, kind, held, start in rows:
        if kind:
            factors.add(make.sighting(tail, head, measured, information, kind, held, poses))
        elif held:
            factors.add(make.prior(head, make.pose(start), make.noise(information)))
        else:
            factors.add(make.edge(tail, head, make.pose(measured), make.noise(information)))
    return factors


def _from_held_nodes(system: System) -> System:
    """The same edges, those into a node that stays turned around: `r' = -Ad(measured) r`."""
    into = (system.free[system.heads] < 0) & (system.free[system.tails] >= 0)
    if system.kinds is not None:
        into &= system.kinds == 0
    if not into.any():
        return system
    measured, information = system.measured.copy(), system.information.copy()
    back = (invert_planar if system.planar else invert)(measured[into])
    adjoint = (planar_adjoint if system.planar else se3_adjoint)(back)
    measured[into] = back
    information[into] = np.swapaxes(adjoint, 1, 2) @ information[into] @ adjoint
    tails, heads = system.tails.copy(), system.heads.copy()
    tails[into], heads[into] = system.heads[into], system.tails[into]
    return replace(system, tails=tails, heads=heads, measured=measured, information=information)


def _targets(system: System, poses: Array) -> Array:
    """(E, 3 or 4, 4) where each edge wants its head."""
    return np.asarray((compose_planar if system.planar else np.matmul)(
        poses[system.tails], system.measured))  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Maker:
    """gtsam's types of the plane or of space."""

    planar: bool
    pose: Callable[[Array], Any]
    edge: Callable[..., Any]
    prior: Callable[..., Any]

    @staticmethod
    def of(planar: bool) -> _Maker:
        if planar:
            pose = lambda row: gtsam.Pose2(*row.tolist())  # noqa: E731
            return _Maker(True, pose, gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)
        return _Maker(False, gtsam.Pose3, gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3)

    @staticmethod
    def noise(information: Array) -> Any:
        return gtsam.noiseModel.Gaussian.Information(information, False)

    def sighting(
        self, tail: int, head: int, measured: Array, information: Array, kind: int, held: bool,
        poses: Array,
    ) -> Any:  # fmt: skip
        """The factor of a landmark at `head`, as seen from the node at `tail`."""
        shift = slice(0, 2) if self.planar else slice(3, 6)
        seen = measured[:2] if self.planar else measured[:3, 3]
        noise = self.noise(np.ascontiguousarray(information[shift, shift]))
        if kind == POINT or held:
            keys = [head] if held else [tail, head]
            node = poses[tail] if held else None
            return gtsam.CustomFactor(noise, keys, _Seen(self.planar, seen, kind, node))
        bearing = gtsam.Rot2(float(seen[0]))
        return gtsam.BearingRangeFactor2D(tail, head, bearing, float(seen[1]), noise)


@dataclass(frozen=True, slots=True)
class _Seen:
    """The error of a sighting that gtsam has no factor for: a position in the node's frame, or
    anything seen from a node that stays.
    """

    planar: bool
    measured: Array
    kind: int
    node: Array | None
    """The pose of the node, if it stays."""

    def __call__(self, factor: Any, values: Any, jacobians: Any) -> Array:
        *_, head = factor.keys()
        pose = self._pose(values, factor.keys()[0]) if self.node is None else self.node
        point = values.atPoint2(head) if self.planar else values.atPoint3(head)
        error, by_node, by_point = sighting_derivatives(
            self.planar, pose, point, self.measured, self.kind
        )
        if jacobians is not None:
            if self.node is None:
                jacobians[0] = by_node
            jacobians[-1] = by_point
        return error

    def _pose(self, values: Any, key: int) -> Array:
        if not self.planar:
            return np.asarray(values.atPose3(key).matrix())
        pose = values.atPose2(key)
        return np.array([pose.x(), pose.y(), pose.theta()])


def values_of(system: System, poses: Array) -> Any:
    """Gtsam's values of all free nodes. `poses` (N, 3 or 4, 4), map_from_node, are of all nodes."""
    values, is_point = gtsam.Values(), system.points
    free = system.free >= 0
    make = _Maker.of(system.planar)
    nodes = np.flatnonzero(free & ~is_point)
    for key, pose in zip(nodes.tolist(), poses[nodes], strict=True):
        values.insert(key, make.pose(pose))
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
