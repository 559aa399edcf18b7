"""How fast a laser's mirror turns, measured on a map: turning robots stretch its sweeps.

    python benchmarks/sweep_rate.py MAP...

A beam at bearing b is taken b times some seconds a radian after the one ahead, and the robot turns
meanwhile. Scans of one visit whose robot turned at different rates are aligned with each other by
point to line; these seconds are a fourth unknown of all pairs together, the same for the whole log.
It is zero where the log's beams are timed, and where its stamps mean nothing. The standard error is
that of pairs drawn anew (bootstrap).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from formats.database import open_store
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    matrix_to_planar,
    planar_exp,
    transform_points_planar,
)
from mapmyworld.places.laser_nodes import load_node_scans
from mapmyworld.registration.scan_matching import ScanSet
from mapmyworld.types import MapStore

Array = NDArray[np.float64]
_AHEAD = 1, 2, 4  # nodes from one scan of a pair to the other
_APART, _REACH, _SCALE = 1.0, 0.15, 0.03  # m: poses, points, and Cauchy's scale
_SLOW, _FAST = 0.05, 3.0  # rad/s: rates that differ less show nothing, and no robot turns faster
_FEWEST = 30  # points of a pair


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("maps", nargs="+", type=Path)
    for path in parser.parse_args().maps:
        with open_store(path, read_only=True) as store:
            found = slopes(store)
        if len(found) == 0:
            print(f"{path.name}: no two scans near each other at different rates")
            continue
        random, (pull, known) = np.random.default_rng(0), found.sum(axis=0)
        drawn = [
            found[random.integers(len(found), size=len(found))].sum(axis=0) for _ in range(200)
        ]
        error = np.std([a / b for a, b in drawn])
        print(
            f"{path.name}: {pull / known:.5f} +- {error:.5f} s/rad of {len(found)} pairs, "
            f"{abs(known / pull) / (2.0 * np.pi):.0f} turns a second"
        )


def slopes(store: MapStore) -> Array:
    """(P, 2) of pairs: their pull on the seconds a radian, and what they know of them."""
    loaded, poses = load_node_scans(store, Config()), store.poses()
    assert poses is not None
    nodes, scans = loaded.nodes, loaded.scans.some(np.arange(len(loaded.nodes)))
    row = {int(i): k for k, i in enumerate(poses.ids)}
    at = matrix_to_planar(poses.map_from_node[[row[node.id] for node in nodes]])
    rates = turning_rates(store, np.array([node.stamp_ns for node in nodes]))
    found = []
    for a in range(len(nodes)):
        for b in (a + ahead for ahead in _AHEAD if a + ahead < len(nodes)):
            apart = np.hypot(*(at[a, :2] - at[b, :2]))
            if abs(rates[a] - rates[b]) >= _SLOW and apart <= _APART:
                found += pair_slope(scans, a, b, between_planar(at[a], at[b]), rates)
    return np.reshape(found, (-1, 2))


def turning_rates(store: MapStore, stamps_ns: NDArray[np.int64]) -> Array:
    """(N,) rad/s at some moments, by the frames' poses; 0 where no robot can turn so fast."""
    poses = store.frame_poses()
    assert poses is not None
    seconds = store.tracked_frames().stamps_ns * 1e-9
    turned = np.diff(np.unwrap(matrix_to_planar(poses)[:, 2]))
    rates = turned / np.maximum(np.diff(seconds), 1e-3)
    found = np.interp(stamps_ns * 1e-9, 0.5 * (seconds[1:] + seconds[:-1]), rates)
    return np.where(np.abs(found) <= _FAST, found, 0.0)


def pair_slope(scans: ScanSet, a: int, b: int, a_from_b: Array, rates: Array) -> list[Array]:
    """[(2,)] of one pair, after two steps of alignment; nothing where few points meet."""
    target, other = (
        scans.rows[scans.bounds[k] : scans.bounds[k + 1]].astype(np.float64) for k in (a, b)
    )
    tree = cKDTree(target[:, :2])
    for _ in range(3):
        points, turned = transform_points_planar(a_from_b, other[:, :2]), a_from_b[2]
        ways = transform_points_planar(np.array([0.0, 0.0, turned]), other[:, 2:4])
        apart, near = tree.query(points)
        normals = target[near, 2:4]
        met = (apart < _REACH) & (np.sum(ways * normals, axis=1) > 0.7)
        if np.count_nonzero(met) < _FEWEST:
            return []
        seen, mine, n = target[near[met]], other[met], normals[met]
        residual = np.sum(n * (points[met] - seen[:, :2]), axis=1)
        back = transform_points_planar(np.array([0.0, 0.0, -turned]), n)  # normals seen from b
        by_turn = back[:, 1] * mine[:, 0] - back[:, 0] * mine[:, 1]
        of_target = n[:, 1] * seen[:, 0] - n[:, 0] * seen[:, 1]
        by_time = rates[b] * mine[:, 4] * by_turn - rates[a] * seen[:, 4] * of_target
        rows = np.column_stack([back, by_turn, by_time])
        weight = 1.0 / (1.0 + (residual / _SCALE) ** 2)
        normal, pull = rows.T @ (rows * weight[:, None]), -rows.T @ (weight * residual)
        pose = normal[:3, :3] + 1e-6 * np.eye(3)
        a_from_b = compose_planar(a_from_b, planar_exp(np.linalg.solve(pose, pull[:3])))
    share = np.linalg.solve(pose, normal[:3, 3])
    return [np.array([pull[3] - share @ pull[:3], normal[3, 3] - share @ normal[:3, 3]])]


if __name__ == "__main__":
    main()
