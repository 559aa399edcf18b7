"""The best particle's path smoothed: its loops recognised, all its scans aligned with each other.

A particle fixes each pose when it passes, with the map of that moment, and of thirty the best one
may come back to a place some decimetres off. Offline the whole path is known, so the posterior over
paths, p(x_1:t | z_1:t, u_1:t), is climbed on from there (Lu and Milios 1997). Which surfaces visits
share is not left to their distance, for equal doors may lie nearer than the right ones: places are
recognised as in the graph, and two visits are compared where that shows how they lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.laser_refinement import refine_poses
from mapmyworld.config import Config
from mapmyworld.decisions import decided_on
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    compose_planar,
    information_from_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.graph.chains import solve_draft
from mapmyworld.graph.solved_graph import SolvedGraph
from mapmyworld.odometry.pose_hypotheses import FEWEST
from mapmyworld.places.laser_nodes import NodeScans
from mapmyworld.places.laser_sections import closures_by_section
from mapmyworld.registration.scan_matching import prepare_scans
from mapmyworld.types import ConstraintKind, Judged, Node, Particles, Poses, Progress, Scan
from mapmyworld.types.frames import nodes_as_frames


def smooth_path(
    path: Array,
    moves: Array,
    covariances: Array,
    odometry: Array,
    stamps_ns: NDArray[np.int64],
    scans: Sequence[Scan],
    config: Config,
    progress: Progress,
) -> Array:
    """The `path` of scans smoothed, (K, 3) both: their loops closed, all of them aligned.

    `stamps_ns` (K,) are the scans'; `moves` (K - 1, 3) lead from each to the next, in the frame of
    their start, with `covariances` (K - 1, 3, 3) in the body frame. Places are looked for from
    where the path has them, as far as the moves may have drifted. `odometry` (K, 3) is the recorded
    one, NaN where the log has none.
    """
    chained = np.array(list(accumulate(moves, compose_planar, initial=np.zeros(3))))
    nodes = _nodes(chained, chained if np.isnan(odometry).any() else odometry, stamps_ns)
    loaded = _loaded(nodes, scans, config)
    motions = _motions(nodes, moves, covariances)

    def solve(constraints: Sequence[Judged], until: int | None) -> SolvedGraph:
        return solve_draft(nodes, constraints, True, config.graph, until)

    start = Poses(np.array([node.id for node in nodes]), planar_to_matrix(path), None)
    closures = closures_by_section(loaded, motions, solve, config, progress, start)
    decided_on("closure", closures)
    solved = solve([*motions, *closures], None)
    frames = nodes_as_frames(nodes)
    refined = refine_poses(frames, solved.poses, solved.constraints, config, progress, loaded)
    return path if refined is None else matrix_to_planar(refined.poses.map_from_node)


def _nodes(tracked: Array, odometry: Array, stamps_ns: NDArray[np.int64]) -> list[Node]:
    """One for each of the scans, at `tracked` (K, 3) and at `odometry` (K, 3)."""
    matrices = zip(planar_to_matrix(odometry), planar_to_matrix(tracked), strict=True)
    return [
        Node(k + 1, 0, stamp, *poses)
        for k, (stamp, poses) in enumerate(zip(stamps_ns.tolist(), matrices, strict=True))
    ]


def _motions(nodes: Sequence[Node], moves: Array, covariances: Array) -> list[Judged]:
    """The moves as constraints between neighbouring nodes."""
    information = information_from_planar(np.linalg.inv(covariances))
    matrices = planar_to_matrix(moves)
    return [
        Judged(node.id, node.id + 1, ConstraintKind.NEIGHBOUR, u, known, Particles())
        for node, u, known in zip(nodes[:-1], matrices, information, strict=True)
    ]


def _loaded(nodes: list[Node], scans: Sequence[Scan], config: Config) -> NodeScans:
    """The nodes with their scans made ready."""
    prepared = prepare_scans(scans, config.registration)
    never = np.zeros(len(nodes), np.bool_)
    return NodeScans(nodes, prepared, never, np.diff(prepared.bounds) >= FEWEST, never)
