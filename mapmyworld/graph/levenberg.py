"""Levenberg-Marquardt by gtsam, from arrays to arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from mapmyworld.config.graph import GraphConfig
from mapmyworld.geometry import Array
from mapmyworld.graph.pose_graph import Index
from mapmyworld.types.pose_graph import Edges


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    poses: Array
    iterations: int
    converged: bool


def minimise(
    start: Array,
    tails: Index,
    heads: Index,
    edges: Edges,
    anchors: Index,
    config: GraphConfig,
) -> Minimum:
    """The local minimum that Levenberg-Marquardt reaches from `start`."""
    planar = start.shape[1:] == (3,)
    factors = gtsam.NonlinearFactorGraph()
    add_edges(factors, planar, tails, heads, edges)
    values = values_from_poses(planar, start)
    _add_anchors(factors, planar, values, anchors)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.tolerance)
    parameters.setAbsoluteErrorTol(config.tolerance)
    optimiser = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters)
    solved = optimiser.optimize()
    iterations = int(optimiser.iterations())
    poses = poses_from_values(planar, solved, len(start))
    return Minimum(poses, iterations, iterations < config.iterations)


def add_edges(factors: Any, planar: bool, tails: Index, heads: Index, edges: Edges) -> None:
    pose: Any = gtsam.Pose2 if planar else gtsam.Pose3
    factor: Any = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
    noise = gtsam.noiseModel.Gaussian.Information
    add = factors.add
    rows = zip(tails.tolist(), heads.tolist(), edges.from_from_to, edges.information, strict=True)
    for tail, head, measured, information in rows:
        motion = pose(*measured) if planar else pose(measured)
        add(factor(tail, head, motion, noise(information)))


def values_from_poses(planar: bool, poses: Array) -> Any:
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose) if planar else gtsam.Pose3(pose))
    return values


def poses_from_values(planar: bool, values: Any, count: int) -> Array:
    if planar:
        return np.array([(p.x(), p.y(), p.theta()) for p in map(values.atPose2, range(count))])
    return np.array([values.atPose3(k).matrix() for k in range(count)])


def _add_anchors(factors: Any, planar: bool, values: Any, anchors: Index) -> None:
    noise = gtsam.noiseModel.Unit.Create(3 if planar else 6)
    for k in anchors.tolist():
        if planar:
            factors.add(gtsam.PriorFactorPose2(k, values.atPose2(k), noise))
        else:
            factors.add(gtsam.PriorFactorPose3(k, values.atPose3(k), noise))
