"""How honest tracked motions are: their errors against a true trajectory, in the stated sigmas.

    python benchmarks/motion_errors.py MAP TRUTH [--steps 1 5 20 100 400]

Motions between nodes so many steps apart, composed of the neighbour constraints with all their
covariances. 1 is honest, more is over-confident; last the same against the map's own poses.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.database import open_store
from formats.trajectory_files import read_trajectory
from mapmyworld.alignment.joint_system import step_covariances
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    matrix_to_planar,
    planar_adjoint,
)
from mapmyworld.types import MapStore

Array = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 5, 20, 100, 400])
    options = parser.parse_args()
    with open_store(options.map, read_only=True) as store:
        nodes, solved = store.nodes(), store.poses()
        path, covariances = tracked(store)
    assert solved is not None
    stamps = np.array([node.stamp_ns for node in nodes], np.int64)
    truth = matrix_to_planar(poses_at(read_trajectory(options.truth), stamps))
    own = matrix_to_planar(solved.map_from_node[solved.ids > 0])
    print(f"{'steps':>6}{'truth':>8}{'x':>6}{'y':>6}{'yaw':>6}{'own poses':>11}")
    for steps in options.steps:
        if steps >= len(nodes):
            break
        whole, axes = normalised(path, covariances, truth, steps)
        numbers = "".join(f"{axis:6.2f}" for axis in axes)
        beside = normalised(path, covariances, own, steps)[0]
        print(f"{steps:6d}{whole:8.2f}{numbers}{beside:11.2f}")


def tracked(store: MapStore) -> tuple[Array, Array]:
    """(N, 3) poses by tracking, and (N, 3, 3) by how much the motion from each on may be off."""
    nodes = store.nodes()
    poses = matrix_to_planar(np.stack([node.tracked_from_base for node in nodes]))
    return poses, step_covariances(nodes, store.constraints())


def normalised(path: Array, covariances: Array, truth: Array, steps: int) -> tuple[float, Array]:
    """Root mean square error of motions of so many steps, in sigmas: of all, of each axis (3,)."""
    first, last = path[:-steps], path[steps:]
    own = planar_adjoint(path[1:])  # a step's covariance is that of its end, in its own frame
    added = np.cumsum(own @ covariances[:-1] @ np.swapaxes(own, 1, 2), axis=0)
    summed = np.concatenate([np.zeros((1, 3, 3)), added])
    back = planar_adjoint(invert_planar(last))
    spread = back @ (summed[steps:] - summed[:-steps]) @ np.swapaxes(back, 1, 2)
    motion = between_planar(truth[:-steps], truth[steps:])
    error = between_planar(motion, compose_planar(invert_planar(first), last))
    chi2 = np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0])
    axes = np.sqrt(np.mean(error**2 / np.einsum("nii->ni", spread), axis=0))
    return float(np.sqrt(chi2.mean() / 3.0)), axes


if __name__ == "__main__":
    main()
