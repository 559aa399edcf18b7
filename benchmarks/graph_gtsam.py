"""What gtsam makes of a graph as its examples use it: one start, one optimiser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from mapmyworld.types.pose_graph import PoseGraph


def plain_gtsam(path: Path, planar: bool) -> tuple[float, float]:
    """Cost and CPU seconds of gtsam as its examples use it: read, one start, one optimiser."""
    started = time.process_time()
    factors, _ = gtsam.readG2o(str(path), not planar)
    read = time.process_time() - started
    anchored = _anchored(factors, planar)  # Python's loop over factors is not gtsam's
    started = time.process_time()
    cost = _solved_by_gtsam(factors, anchored, planar)
    return cost, read + time.process_time() - started


def _anchored(factors: Any, planar: bool) -> Any:
    """The graph from which a start is made; LAGO takes diagonal noise alone."""
    if not planar:
        unit = gtsam.noiseModel.Unit.Create(6)
        factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), unit))
        return factors
    diagonal = gtsam.NonlinearFactorGraph()
    for k in range(factors.size()):
        factor = factors.at(k)
        noise = gtsam.noiseModel.Diagonal.Variances(np.diag(factor.noiseModel().covariance()))
        a, b = factor.keys()
        diagonal.add(gtsam.BetweenFactorPose2(a, b, factor.measured(), noise))
    anchor = gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3))
    diagonal.add(anchor)
    factors.add(anchor)
    return diagonal


def _solved_by_gtsam(factors: Any, anchored: Any, planar: bool) -> float:
    initialise = gtsam.lago.initialize if planar else gtsam.InitializePose3.initialize
    optimiser = gtsam.LevenbergMarquardtOptimizer(factors, initialise(anchored))
    return float(factors.error(optimiser.optimize()))


def examples_cost(graph: PoseGraph) -> float:
    """The cost where gtsam ends."""
    factors = _factors(graph)
    return _solved_by_gtsam(factors, _anchored(factors, graph.planar), graph.planar)


def _factors(graph: PoseGraph) -> Any:
    noise = gtsam.noiseModel.Gaussian.Information
    pose, factor = (
        (gtsam.Pose2, gtsam.BetweenFactorPose2)
        if graph.planar
        else (gtsam.Pose3, gtsam.BetweenFactorPose3)
    )
    edges, factors = graph.edges, gtsam.NonlinearFactorGraph()
    rows = zip(
        edges.from_ids.tolist(),
        edges.to_ids.tolist(),
        edges.i_from_j,
        edges.information,
        strict=True,
    )
    for a, b, motion, information in rows:
        measured = pose(*motion) if graph.planar else pose(motion)
        factors.add(factor(a, b, measured, noise(information)))
    return factors
