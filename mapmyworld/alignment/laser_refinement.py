"""Final poses from all scans at once: every scan aligned with all others that see the same."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.alignment.joint_alignment import align_in_rounds
from mapmyworld.alignment.joint_covariance import (
    RelativeCertainty,
    carried,
    of_anchors,
    shape_covariances,
    without_unmatched,
)
from mapmyworld.alignment.joint_odometry import calibrated_odometry
from mapmyworld.alignment.joint_system import (
    NOTHING,
    Statements,
    joint_system,
    node_motions,
    step_covariances,
)
from mapmyworld.alignment.laser_pairs import (
    AHEAD,
    ComparedScans,
    among_first_revisits,
    field_of_view,
)
from mapmyworld.backend.block_matrix import diagonals
from mapmyworld.backend.system import with_edges, with_information
from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    covariance_from_planar,
    interpolate_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.graph.covariance import marginal_covariances
from mapmyworld.odometry.sweep_noise import sweep_variances
from mapmyworld.odometry.unobserved_motion import FARTHEST
from mapmyworld.places.laser_nodes import NodeScans
from mapmyworld.registration.scan_matching import FINE, ScanSet
from mapmyworld.types import Judged, Node, Poses, Progress, TrackedFrames


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """Where the nodes are after all scans have been aligned with each other."""

    poses: Poses
    moved: tuple[float, ...]
    """Root mean square movement in each round, metres."""
    residual: float
    """Root mean square distance between points and other scans' lines, metres."""
    scan_noise: tuple[float, ...]
    """(3,) m^2, m^2, rad^2: the median of the scans' own noise in x, y, yaw of the robot."""
    certainty: RelativeCertainty
    """How certainly the nodes lie beside each other, but for this noise."""


def refine_poses(
    frames: TrackedFrames,
    poses: Poses,
    constraints: Sequence[Judged],
    config: Config,
    progress: Progress,
    loaded: NodeScans,
    session: Index | None = None,
) -> Refinement | None:
    """Solved poses, refined by all scans; None where there are too few scans.

    Priors, landmarks, images and what a person stated hold them as they held the solution. Nodes
    that are not aligned themselves keep their place between those that are. Scans on
    different ones of these `session`s (N,) are not compared: nothing shows how these lie.
    """
    nodes, scans = loaded.nodes, loaded.scans
    if len(nodes) < 3:
        return None
    progress.stage("refine", len(FINE), "rounds")
    rows = {int(i): row for row, i in enumerate(poses.ids)}
    solved = matrix_to_planar(np.stack([poses.map_from_node[rows[n.id]] for n in nodes]))
    sessions = _sessions(nodes, np.cumsum(loaded.lost))
    statements = Statements.of(nodes, constraints)
    chosen = np.concatenate([spaced_nodes(solved[a:b], config) + a for a, b in sessions])
    chosen = np.union1d(chosen, statements.concerns(nodes))
    session = np.zeros(len(nodes), np.int64) if session is None else session
    drift = _drift(nodes, constraints)
    held = scans.some(chosen)
    scans.let_go()
    task = _Task(nodes, frames, chosen, chosen, held, constraints, statements, session, config)
    found = _aligned(task, solved[chosen], statements.places_of(poses), progress)
    every = np.concatenate(
        [
            carry_along(solved[a:b], chosen[mine] - a, found.poses[mine], drift[a:b])
            for a, b in sessions
            for mine in [(chosen >= a) & (chosen < b)]
        ]
    )
    row = np.searchsorted(chosen, np.arange(len(every)), side="right") - 1
    moved = np.concatenate([every, found.landmarks])
    where = np.array([rows[int(i)] for i in (*(n.id for n in nodes), *statements.landmarks)])
    matrices = np.array(poses.map_from_node)
    matrices[where] = _replace_planar(matrices[where], moved)
    spread = poses.covariances
    if spread is not None and found.spread is not None:
        spread = np.array(spread)
        spread[where] = covariance_from_planar(_spread_of_all(every, chosen, row, found))
    refined = Poses(poses.ids, matrices, spread)
    noise = np.median(found.own.diagonal(0, 1, 2), axis=0)
    certainty = found.certainty.carried_to(every, row)
    return Refinement(refined, found.moved, found.residual, tuple(noise.tolist()), certainty)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """The scans that are to be aligned with each other."""

    nodes: Sequence[Node]
    frames: TrackedFrames
    spaced: Index
    """(P,) the nodes whose scans are aligned in the end."""
    chosen: Index
    """(S,) the nodes they were taken at."""
    scans: ScanSet
    """These."""
    constraints: Sequence[Judged]
    statements: Statements
    session: Index
    """(N,) of all nodes, the component of the path that each is in."""
    config: Config


@dataclass(frozen=True, slots=True, eq=False)
class _Aligned:
    """Poses (S, 3) of scans, and (L, 3) of landmarks."""

    poses: Array
    landmarks: Array
    moved: tuple[float, ...]
    residual: float
    spread: Array | None
    """(S + L, 3, 3) covariances of these without the scans' own noise; None where they are open."""
    own: Array
    """(S, 3, 3) each scan's own noise."""
    anchors: Index
    """(A,) scans that stay, in components that no prior places in the map."""
    certainty: RelativeCertainty
    """How certainly the scans lie beside each other, but for their own noise."""


def _aligned(task: _Task, poses: Array, landmarks: Array, progress: Progress) -> _Aligned:
    """All scans: the first visits of every place with each other, later ones with these.

    Later ones begin where the nearest of the first ones were moved. So the factor graph grows with
    the area that was seen, and not with how often it was. What is stated holds the first ones: a
    node that it concerns is among them.
    """
    # Components that nothing joins may lie over each other: their places are not the same.
    places = np.column_stack([poses[:, :2], FARTHEST * task.session[task.chosen]])
    first = among_first_revisits(places, poses[:, 2], task.config.odometry.refine_references)
    first |= np.isin(task.chosen, task.statements.concerns(task.nodes))
    rows = np.flatnonzero(first)
    some = replace(task, chosen=task.chosen[rows], scans=task.scans.some(rows))
    shaped = _rounds(some, poses[rows], landmarks, np.zeros(len(rows), np.bool_), progress)
    if first.all():
        return shaped
    near = cKDTree(places[rows]).query(places)[1]
    near[rows] = np.arange(len(rows))
    moved = _moved_with(poses, rows[near], shaped.poses[near])
    others = replace(task, statements=NOTHING)
    later = _rounds(others, moved, landmarks[:0], first, progress)
    nowhere = FARTHEST**2 * np.tile(np.eye(3), (len(places), 1, 1))
    against = nowhere if later.spread is None else later.spread
    certainty = replace(shaped.certainty, poses=later.poses, near=near, against=against)
    return replace(
        shaped, poses=later.poses, moved=shaped.moved + later.moved,
        spread=_spread_of_both(shaped, later, near), own=later.own, anchors=rows[shaped.anchors],
        certainty=certainty,
    )  # fmt: skip


def _spread_of_both(shaped: _Aligned, later: _Aligned, near: Index) -> Array | None:
    """Later scans err as those do that shape the map `near` (S,) them, and by what they err against
    it.
    """
    if shaped.spread is None or later.spread is None:
        return None
    with_map = carried(shaped.spread[near], shaped.poses[near], later.poses)
    return np.concatenate([with_map + later.spread, shaped.spread[len(shaped.poses) :]])


def _spread_of_all(every: Array, chosen: Index, row: Index, found: _Aligned) -> Array:
    """(N + L, 3, 3) covariances of all nodes and landmarks, given those of the chosen nodes.

    Nodes, at `every` (N, 3) pose, move with the one of `chosen` (S,) at their `row` (N,).
    """
    assert found.spread is not None
    count = len(chosen)
    spread = carried(found.spread[row], every[chosen[row]], every) + found.own[row]
    spread[chosen[found.anchors]] = 0.0
    return np.concatenate([spread, found.spread[count:]])


def _rounds(
    task: _Task, poses: Array, landmarks: Array, held: NDArray[np.bool_], progress: Progress
) -> _Aligned:
    """The scans aligned with each other; where some are held, with these."""
    settings, config = task.config.odometry, task.config
    count = len(poses)
    stays = np.append(held, np.zeros(len(landmarks), np.bool_))
    given, start = (task.nodes, task.chosen, task.constraints), np.concatenate([poses, landmarks])
    motions = node_motions(*given)
    system, start = joint_system(*given, task.statements, start, stays, task.spaced)
    alone = {c.to_id for c in task.constraints if c.is_unmatched}
    blind = np.cumsum([node.id in alone for node in task.nodes])[task.chosen]
    lap = np.searchsorted(task.spaced, task.chosen) - np.arange(count)  # counts what is left out
    matched = (blind[motions[0]] == blind[motions[1]]) & (lap[motions[0]] == lap[motions[1]])
    stated, field = with_edges(system, *motions), field_of_view(task.scans.rows[:, 4])
    compared = ComparedScans(task.session[task.chosen], held, stated, start, field, settings)
    compare = compared.pairs_at
    odometry, known = calibrated_odometry(task.nodes, task.chosen, motions, matched)
    behind, system = len(system.tails), with_edges(system, *odometry)
    found = align_in_rounds(task.scans, system, start, compare, config, progress)
    every, residual = found.poses, found.residual
    own = shape_covariances(task.scans, residual)
    noise = np.median(own.diagonal(0, 1, 2), axis=0)
    own += diagonals(sweep_variances(task.nodes, task.frames, noise, settings)[task.chosen])
    certain = with_information(found.joint, behind, known)
    certain = without_unmatched(certain, found.pairs, blind, AHEAD)
    mapped = len(poses) + len(landmarks)  # the map's frame is a node as well
    spread, anchors = marginal_covariances(certain, every), np.zeros(0, np.int64)
    if spread is not None:
        spread = spread[:mapped]
        if not held.any():
            spread += of_anchors(found.joint, own, every)[:mapped]
            anchors = np.flatnonzero(found.joint.free[:count] < 0)
    rest = found.moved, residual, spread, own, anchors, RelativeCertainty.of(certain, every, count)
    return _Aligned(every[:count], every[count:mapped], *rest)


def _sessions(nodes: Sequence[Node], tracked: Index) -> list[tuple[int, int]]:
    """First node and one past the last of sections without a loss; carrying stays within."""
    both = np.stack([[node.session for node in nodes], tracked])
    edges = [0, *(np.flatnonzero(np.diff(both).any(axis=0)) + 1).tolist(), len(nodes)]
    return list(itertools.pairwise(edges))


def _drift(nodes: Sequence[Node], constraints: Sequence[Judged]) -> Array:
    """(N,) variance (m^2) of the position that all motions up to each node sum up to."""
    steps = step_covariances(nodes, constraints)[:-1, :2, :2].trace(axis1=1, axis2=2)
    return np.concatenate([[0.0], np.cumsum(steps)])


def spaced_nodes(poses: Array, config: Config) -> Index:
    """(K,) indices of `poses` (N, 3) that moved far enough since the one listed before them."""
    settings = config.odometry
    kept = [0]
    for k in range(1, len(poses)):
        step = between_planar(poses[kept[-1]], poses[k])
        far = np.hypot(step[0], step[1]) >= settings.refine_distance
        if far or abs(step[2]) >= settings.refine_angle:
            kept.append(k)
    return np.array(kept, np.int64)


def carry_along(solved: Array, chosen: Index, refined: Array, drift: Array) -> Array:
    """The `solved` poses, carried along, (N, 3) both.

    Those between two of `chosen` (K,), which are now at `refined` (K, 3), share out what the two
    were moved by, each motion as much as it adds to the `drift` (N,).
    """
    row = np.searchsorted(chosen, np.arange(len(solved)), side="right") - 1
    after = np.minimum(row + 1, len(chosen) - 1)
    by_row = _moved_with(solved, chosen[row], refined[row])
    by_after = _moved_with(solved, chosen[after], refined[after])
    span = drift[chosen[after]] - drift[chosen[row]]
    way = np.where(after > row, drift - drift[chosen[row]], 0.0)
    return interpolate_planar(by_row, by_after, way / np.where(span > 0.0, span, 1.0))


def _moved_with(solved: Array, reference: Index, refined: Array) -> Array:
    return compose_planar(refined, between_planar(solved[reference], solved))


def _replace_planar(matrices: Array, planar: Array) -> Array:
    """Matrices with x, y, yaw replaced, and their height kept."""
    result = planar_to_matrix(planar)
    result[:, 2, 3] = matrices[:, 2, 3]
    return result
