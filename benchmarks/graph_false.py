"""False closures, alone or in groups that agree with themselves and with odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.config import GraphConfig
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.geometry.rigid import between, make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation
from mapmyworld.graph.optimisation import optimise
from mapmyworld.types.pose_graph import Edges, PoseGraph


def with_false(graph: PoseGraph, share: float, seed: int, group: int = 1) -> PoseGraph:
    """The graph with so many false closures that they are this share of all closures.

    Measured are random relative poses within a fifth of the world. In groups, neighbouring nodes
    see one wrong place, so that the closures of a group agree with each other and odometry.
    """
    rng = np.random.default_rng(seed)
    edges, count = graph.edges, len(graph)
    closures = np.flatnonzero(~edges.odometry)
    number = round(len(closures) * share / (1.0 - share) / group)
    solved = optimise(graph, GraphConfig(certify=False)).graph.map_from_node
    places = solved[:, :2] if graph.planar else solved[:, :3, 3]
    reach = 0.1 * float(np.ptp(places, axis=0).max())
    tails, heads, motions = [], [], []
    while len(tails) < number * group:
        a, b = rng.integers(0, count - group, 2)
        if abs(a - b) < 20 + group:
            continue
        base = _random_motion(graph.planar, reach, rng)
        if _is_true(graph.planar, solved[a], solved[b], base):
            continue
        for k in range(group):
            motions.append(_joined(graph.planar, solved, int(a), int(b), k, base))
            tails.append(int(a) + k)
            heads.append(int(b) + k)
    information = edges.information[closures[rng.integers(0, len(closures), len(tails))]]
    return replace(
        graph,
        edges=Edges(
            np.concatenate([edges.from_ids, graph.ids[tails]]),
            np.concatenate([edges.to_ids, graph.ids[heads]]),
            np.concatenate([edges.i_from_j, np.array(motions)]),
            np.concatenate([edges.information, information]),
            np.concatenate([edges.odometry, np.zeros(len(tails), np.bool_)]),
        ),
    )


def _random_motion(planar: bool, reach: float, rng: np.random.Generator) -> np.ndarray:
    if planar:
        return np.array([*rng.uniform(-reach, reach, 2), rng.uniform(-np.pi, np.pi)])
    turn = quaternion_to_rotation(rng.normal(size=4))
    return make_transform(turn, rng.uniform(-reach, reach, 3))


def _is_true(planar: bool, a: np.ndarray, b: np.ndarray, drawn: np.ndarray) -> bool:
    """Whether a drawn closure happens to be right: within 0.3 m and 0.1 rad (6 deg)."""
    if planar:
        error = between_planar(drawn, between_planar(a, b))
        return bool(np.hypot(*error[:2]) < 0.3 and abs(error[2]) < 0.1)
    error = between(drawn, between(a, b))
    return bool(
        np.linalg.norm(error[:3, 3]) < 0.3 and np.trace(error[:3, :3]) > 1 + 2 * np.cos(0.1)
    )


def _joined(
    planar: bool, poses: np.ndarray, a: int, b: int, k: int, base: np.ndarray
) -> np.ndarray:
    """What node a + k sees of b + k when a sees b at `base`."""
    if planar:
        back = between_planar(poses[a + k], poses[a])
        return compose_planar(compose_planar(back, base), between_planar(poses[b], poses[b + k]))
    return between(poses[a + k], poses[a]) @ base @ between(poses[b], poses[b + k])
