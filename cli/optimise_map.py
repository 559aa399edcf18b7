"""A solved graph as a map: nodes without data, constraints with verdicts, poses, uncertainty."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from formats.database import open_store
from formats.database.connection import says_ours
from formats.graph_files import cartesian
from mapmyworld.geometry.planar import information_from_planar, planar_to_matrix
from mapmyworld.graph.covariance import graph_covariances
from mapmyworld.graph.optimisation import OptimisedGraph
from mapmyworld.types import (
    ConstraintKind,
    Judge,
    Judged,
    Node,
    NodeData,
    Poses,
    Verdict,
    Why,
)
from mapmyworld.types.pose_graph import PoseGraph

_CARRIED = Verdict(Judge.GRAPH, False, Why.CARRIED_OVER)
_LOOSE = 1e-9  # information of a landmark's orientation: it has none


def write_map(
    path: Path, source: Path, given: PoseGraph, solved: OptimisedGraph, losses: Sequence[str]
) -> None:
    """The solved graph of `source` as a map in `path`, which RTAB-Map's tools open as well.

    A map keeps its nodes' data; from any other file come nodes without data, numbered from 1.
    `losses` say what the graph lacks, so that the map does not pass as whole.
    """
    graph = solved.graph
    ours = says_ours(source)
    shift = 0 if ours else max(0, 1 - int(graph.ids.min()))
    if ours:
        shutil.copyfile(source, path)
    covariances = graph_covariances(graph, solved.accepted)
    poses = Poses(*_placed(graph, shift), covariances)
    with open_store(path, create=True, overwrite=not ours) as store:
        before = store.constraints() if ours else ()
        if not ours:
            with store.write_stage("track", "graph"):
                store.put("plan", {"planar": graph.planar})
                start = matrices_of(graph.planar, given.map_from_node)
                for node, pose in zip((graph.ids + shift).tolist(), start, strict=True):
                    store.add_node(Node(node, 0, node * 1_000_000_000, pose, pose), NodeData())
        judged = _rejudged(before, solved) if ours else constraints_of(solved, shift)
        if not ours:
            with store.write_stage("recognise", "graph"):
                store.add_constraints([c.before(Judge.GRAPH) for c in judged])
        with store.write_stage("optimise", "graph"):
            # What was cleared of a map's verdicts, and of what they measured, is carried over.
            carried = [c.judged(_CARRIED) for c in store.constraints()] if ours else []
            store.judge([*carried, *judged])
            store.set_poses(poses)
            store.put("solve", {"certainty": solved.certainty, "losses": list(losses)})


def matrices_of(planar: bool, poses: np.ndarray) -> np.ndarray:
    """Poses (N, 3 or 4, 4) of a graph as motions in space (N, 4, 4)."""
    return planar_to_matrix(poses) if planar else poses


def _placed(graph: PoseGraph, shift: int) -> tuple[np.ndarray, np.ndarray]:
    """Ids and poses of nodes, then of landmarks, whose ids are negative in a map."""
    marks = np.tile(np.eye(4), (len(graph.landmark_ids), 1, 1))
    marks[:, : graph.landmarks.shape[1], 3] = graph.landmarks
    ids = np.concatenate([graph.ids + shift, -1 - np.arange(len(marks))])
    return ids, np.concatenate([matrices_of(graph.planar, graph.map_from_node), marks])


def _rejudged(constraints: Sequence[Judged], solved: OptimisedGraph) -> tuple[Judged, ...]:
    """A map's own constraints, those left out by the solution rejected."""
    edges, chi2 = solved.graph.edges.chosen(~solved.accepted), solved.squared_sigmas
    ends = zip(edges.from_ids.tolist(), edges.to_ids.tolist(), strict=True)
    out = dict(zip(ends, chi2[~solved.accepted].tolist(), strict=True))
    return tuple(
        c.judged(_missing(False, out[c.from_id, c.to_id]))
        if c.accepted and (c.from_id, c.to_id) in out
        else c
        for c in constraints
    )


def _missing(accepted: bool, chi2: float) -> Verdict:
    return Verdict(Judge.GRAPH, accepted, Why.MISSES, {"sigmas": float(chi2**0.5)})


def constraints_of(solved: OptimisedGraph, shift: int = 0) -> tuple[Judged, ...]:
    """Edges, priors and sightings of the solved graph, with their verdicts."""
    graph, edges = solved.graph, solved.graph.edges
    planar = graph.planar
    motions = matrices_of(planar, edges.i_from_j)
    information = information_from_planar(edges.information) if planar else edges.information
    kinds = (ConstraintKind.LOOP_CLOSURE, ConstraintKind.NEIGHBOUR)
    made = [
        Judged(
            int(a) + shift,
            int(b) + shift,
            kinds[int(odometry)],
            motion,
            weight,
            verdicts=(_missing(bool(good), chi2),),
        )
        for a, b, odometry, motion, weight, good, chi2 in zip(
            edges.from_ids,
            edges.to_ids,
            edges.odometry,
            motions,
            information,
            solved.accepted,
            solved.squared_sigmas,
            strict=True,
        )
    ]
    return (*made, *_priors(graph, shift), *_sightings(graph, shift))


def _priors(graph: PoseGraph, shift: int) -> list[Judged]:
    priors = graph.priors
    poses = matrices_of(
        graph.planar, priors.map_from_node.reshape(-1, *graph.map_from_node.shape[1:])
    )
    weights = information_from_planar(priors.information) if graph.planar else priors.information
    return [
        Judged(int(k) + shift, int(k) + shift, ConstraintKind.PRIOR, pose, weight)
        for k, pose, weight in zip(priors.ids, poses, weights, strict=True)
    ]


def _sightings(graph: PoseGraph, shift: int) -> list[Judged]:
    if len(graph.sightings) == 0:
        return []
    seen = cartesian(graph.sightings) if graph.planar else graph.sightings
    marks = np.searchsorted(graph.landmark_ids, seen.landmark_ids)
    size = seen.measured.shape[1]
    made = []
    for k in range(len(seen)):
        motion, weight = np.eye(4), np.eye(6)
        motion[:size, 3] = seen.measured[k]
        weight[:3, :3] *= _LOOSE
        weight[3 : 3 + size, 3 : 3 + size] = seen.information[k]
        ends = int(seen.node_ids[k]) + shift, -1 - int(marks[k])
        made.append(Judged(*ends, ConstraintKind.LANDMARK, motion, weight))
    return made
