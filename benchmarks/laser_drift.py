"""Is a drive recognised that comes back drifted? A built map's tracked poses are bent on purpose.

python benchmarks/laser_drift.py MAP.db [--bend 0.0005] [--stretch 0.03] [--rounds 3]

Every metre of path is stretched by a share and turned by so many radians. Closures are then
sought as in a build, by rounds of search and optimisation, and judged by the map's own poses.
"""

from __future__ import annotations

import argparse
import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database import open_store
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.graph.solved_graph import solve
from mapmyworld.places.laser_closures import find_laser_closures
from mapmyworld.places.laser_nodes import load_node_scans
from mapmyworld.places.laser_sections import closures_by_section
from mapmyworld.stages.recognise import solve_draft_of
from mapmyworld.types import ConstraintKind, Judged, MapStore, Node, Poses

Array = NDArray[np.float64]


class Known:
    """As much of a store as looking for closures needs."""

    def __init__(self, nodes: list[Node], constraints: list[Judged]) -> None:
        self.listed, self.found = nodes, constraints

    def nodes(self) -> list[Node]:
        return self.listed

    def get(self, key: str) -> dict[str, bool] | None:
        return {"planar": True} if key == "plan" else None

    def constraints(self) -> tuple[Judged, ...]:
        return tuple(self.found)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("--bend", type=float, default=0.0005, help="rad per metre")
    parser.add_argument("--stretch", type=float, default=0.03, help="metres per metre")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    run(open_store(arguments.map), arguments.bend, arguments.stretch, arguments.rounds)


def run(store: MapStore, bend: float, stretch: float, rounds: int) -> None:
    """Prints what drift there is, and what is left of it after each round."""
    config = Config()
    loaded = load_node_scans(store, config)
    nodes = loaded.nodes
    final = store.poses()
    assert final is not None
    truth = dict(zip(final.ids.tolist(), final.map_from_node, strict=True))
    bent = drifted(matrix_to_planar(np.stack([n.tracked_from_base for n in nodes])), bend, stretch)
    listed = [
        replace(node, tracked_from_base=pose)
        for node, pose in zip(nodes, planar_to_matrix(bent), strict=True)
    ]
    known: Any = Known(listed, neighbours(listed, store))
    print(f"drift at the end: {apart(listed[-1].tracked_from_base, truth[listed[-1].id]):.1f} m")
    ids = np.array([node.id for node in listed])
    start = np.stack([node.tracked_from_base for node in listed])
    loaded = loaded._replace(nodes=listed)
    draft = functools.partial(solve_draft_of, known, config)
    known.found += closures_by_section(loaded, known.constraints(), draft, config, Silent())
    for turn in range(rounds):
        solved = solve(ids, start, known.found, True, replace(config.graph, covariances=False))
        report(turn, solved.constraints, solved.poses, truth)
        tied = solved.constraints
        known.found += find_laser_closures(known, solved.poses, config, Silent(), loaded, tied)


def drifted(poses: Array, bend: float, stretch: float) -> Array:
    """Poses (N, 3) whose every step is longer by a share and turned by `bend` a metre."""
    steps = between_planar(poses[:-1], poses[1:])
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, :2] *= 1.0 + stretch
    steps[:, 2] += bend * lengths
    bent = [poses[0]]
    for step in steps:
        bent.append(compose_planar(bent[-1], step))
    return np.stack(bent)


def neighbours(nodes: list[Node], store: MapStore) -> list[Judged]:
    """The map's neighbour constraints, measuring the bent motion, as wide as its errors."""
    pose = {node.id: node.tracked_from_base for node in nodes}
    result = []
    for c in store.constraints():
        if c.kind is ConstraintKind.NEIGHBOUR and c.from_id in pose and c.to_id in pose:
            moved = between(pose[c.from_id], pose[c.to_id])
            wide = np.asarray(np.linalg.inv(np.linalg.inv(c.information) + np.eye(6) * 1e-4))
            result.append(replace(c, i_from_j=moved, information=wide))
    return result


def apart(a: Array, b: Array) -> float:
    return float(np.hypot(*(a[:2, 3] - b[:2, 3])))


def report(
    turn: int, constraints: tuple[Judged, ...], poses: Poses, truth: dict[int, Array]
) -> None:
    """One line a round: closures, how many of them are right, and what the poses are off by."""
    closures = [c for c in constraints if c.kind is not ConstraintKind.NEIGHBOUR]
    kept = [c for c in closures if c.accepted]
    errors = [between(between(truth[c.from_id], truth[c.to_id]), c.i_from_j) for c in kept]
    right = [np.hypot(*e[:2, 3]) <= 0.2 and rotation_angle(e) <= np.radians(1.0) for e in errors]
    there = matrix_to_planar(np.stack([truth[int(i)] for i in poses.ids]))
    error = between_planar(there, matrix_to_planar(poses.map_from_node))
    print(
        f"round {turn + 1}: {len(closures)} tried, {len(kept)} accepted, {sum(right)} right; "
        f"poses off by {np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))):.3f} m (rms), "
        f"{np.abs(error[-1, :2]).max():.3f} m at the end"
    )


if __name__ == "__main__":
    main()
