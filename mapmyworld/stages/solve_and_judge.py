"""The stage that optimises the graph, looks again from the better poses, and judges."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mapmyworld.config import Config
from mapmyworld.decisions import decided, decided_on
from mapmyworld.graph.audit import ConstraintResidual
from mapmyworld.graph.chains import solve_by_chains
from mapmyworld.graph.edited import Strain, contradicted, contradiction, strained
from mapmyworld.graph.edited_constraints import apply_edits, edits_from_json, unmet
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.graph.solved_graph import SolvedGraph, component_losses
from mapmyworld.graph.variance import variance_factors
from mapmyworld.map_figures import components_of
from mapmyworld.parallel import on_one_thread
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.stages.kept import has_images
from mapmyworld.stages.level_map import levelled_poses
from mapmyworld.stages.recognise import LoadScans, add_closures, solve_draft_of
from mapmyworld.types import CLOSURES, Judged, MapStore, Poses, Progress
from mapmyworld.types.edits import Edit, EditAction

_ROUNDS = 4  # looks from better poses, at most; each finds less than the one before
_FEW = 0.05  # share of new closures among all from which another look is not worth its time

_ALONE = 20  # contradicted statements up to which each is left out by itself


@on_one_thread
def solve_and_judge(
    store: MapStore, config: Config, progress: Progress, scans: LoadScans, since: int = 0
) -> None:
    """Optimises, tries proximity constraints from the optimised poses, until none is new.

    Among nodes with ids before `since` none is tried.
    """
    for _ in range(_ROUNDS):
        progress.stage("optimise", len(store.nodes()), "nodes")
        draft = solve_draft_of(store, config, _edited(store))
        new = add_closures(store, draft, config, progress, scans, since)
        decided("optimise", f"{new} new closures from the poses of this round")
        if new <= _FEW * sum(c.accepted for c in store.constraints() if c.kind in CLOSURES):
            break
    _confirm_odometry(store, config)
    solved = _solve(store, _edited(store), config, progress)
    poses, constraints, noise = _refined(store, solved, config, progress, scans)
    decided_on("verdict", (c for c in constraints if c.verdicts))
    store.judge(constraints)
    poses, levelled = levelled_poses(store, poses, constraints, config)
    notes = [*levelled, *_unrecognised_notes(store, poses, constraints, scans)]
    for note in notes:
        progress.note(note)
    store.set_poses(poses)
    frames = store.tracked_frames()
    store.set_frame_poses(pose_every_frame(store.nodes(), poses, frames, constraints))
    wanted = [edit for edit in _edits(store) if edit.action is EditAction.ACCEPT]
    others = unmet(constraints, wanted)
    others += _contradictions(store, config, progress, solved, poses)
    others += _misplaced(store, scans)
    note_solution(store, solved.certainty, others, notes, _divides(scans), noise)


def _confirm_odometry(store: MapStore, config: Config) -> None:
    """Motions in doubt that closures do not need to be faults are certain again."""
    constraints = store.constraints()
    if any(c.is_doubted for c in constraints):
        from mapmyworld.places.confirmed_odometry import confirmed_odometry

        edits = _edits(store)
        judged = confirmed_odometry(
            constraints, lambda some: solve_draft_of(store, config, apply_edits(some, edits))
        )
        decided_on("verdict", (c for c in judged if c.is_superseded))
        store.judge(judged)


def note_solution(
    store: MapStore,
    certainty: str,
    losses: Sequence[str],
    notes: Sequence[str],
    divides: Sequence[int],
    scan_noise: Sequence[float],
) -> None:
    """What is known of the solution in the store; its components are counted here, and by how much
    its constraints contradict each other.
    """
    poses, constraints = store.poses(), store.constraints()
    assert poses is not None
    parted = _component_losses(constraints, poses, divides)
    factors = {}
    if scan_noise:  # else constraints state this as well
        factors = variance_factors(store.nodes(), constraints, poses, planar=True)
    reported: dict[str, Any] = {
        "certainty": certainty,
        "losses": [*parted, *losses],
        "notes": list(notes),
        "variance_factors": factors,
        "scan_noise": list(scan_noise),
    }
    reported |= {"parted": parted} if parted else {}
    store.put("solve", reported | ({"divides": list(divides)} if divides else {}))


def _refined(
    store: MapStore, solved: SolvedGraph, config: Config, progress: Progress, scans: LoadScans
) -> tuple[Poses, tuple[Judged, ...], tuple[float, ...]]:
    """Poses after all laser scans have been aligned with each other, closures judged by them, and
    the variances of a scan's own noise.

    Without a laser they stay as they were solved, and no scan has any.
    """
    loaded = scans()
    if loaded is None or not (moves_in_plane(store) and config.odometry.refine):
        return solved.poses, solved.constraints, ()
    from mapmyworld.alignment.closure_refinement import refine_closures
    from mapmyworld.alignment.laser_refinement import refine_poses
    from mapmyworld.places.laser_nodes import joined_sessions

    session = joined_sessions(loaded, solved.constraints)
    frames = store.tracked_frames()
    refined = refine_poses(
        frames, solved.poses, solved.constraints, config, progress, loaded, session
    )
    if refined is None:
        return solved.poses, solved.constraints, ()
    known = refined.certainty.standard_deviations
    constraints = refine_closures(solved.constraints, refined.poses, known, config, loaded)
    return refined.poses, constraints, refined.scan_noise


def _divides(scans: LoadScans) -> list[int]:
    """Nodes before which tracking was lost, and wheels do not measure the motion meanwhile."""
    loaded = scans()
    if loaded is None:
        return []
    from mapmyworld.places.laser_nodes import joined_sessions

    begins = 1 + np.flatnonzero(np.diff(joined_sessions(loaded, ())))
    return [loaded.nodes[row].id for row in begins.tolist()]


def _component_losses(
    constraints: Sequence[Judged], poses: Poses, divides: Sequence[int]
) -> list[str]:
    """What divides the map, where nothing recognised joins its components again."""
    count = len(components_of(constraints, poses, divides))
    if count > 1 and divides:
        return [f"Tracking was lost. The map has {count} components with unknown relative pose."]
    return component_losses(count)


def _unrecognised_notes(
    store: MapStore, poses: Poses, constraints: Sequence[Judged], scans: LoadScans
) -> list[str]:
    """Known ground that images did not recognise, where no laser holds the path there."""
    if scans() is not None or not has_images(store):
        return []
    from mapmyworld.places.unrecognised import unrecognised_notes

    return unrecognised_notes(store.nodes(), poses, constraints)


def _edits(store: MapStore) -> tuple[Edit, ...]:
    return edits_from_json(store.get("edits"))


def _edited(store: MapStore) -> tuple[Judged, ...]:
    """What was found, as people's edits want it: they concern the solution, not what is found."""
    return apply_edits(store.constraints(), _edits(store))


def _contradictions(
    store: MapStore, config: Config, progress: Progress, solved: SolvedGraph, poses: Poses
) -> list[str]:
    """What a person stated and the final poses do not meet, with what the graph without it meets.

    Of many, each is left out with the others: a solution takes its time.
    """
    planar = moves_in_plane(store)
    unmet_ones = contradicted(solved.constraints, poses, planar)
    quick = replace(config, graph=replace(config.graph, covariances=False))

    def fought(left_out: Sequence[ConstraintResidual]) -> list[Strain]:
        out = {id(one.constraint) for one in left_out}
        others = [c for c in solved.constraints if id(c) not in out]
        without = _solve(store, others, quick, progress)
        return strained(
            (without.constraints, without.poses), (solved.constraints, solved.poses), planar
        )

    together = functools.cache(lambda: fought(unmet_ones))
    few = len(unmet_ones) <= _ALONE
    return [contradiction(one, (few and fought([one])) or together()) for one in unmet_ones]


def _misplaced(store: MapStore, scans: LoadScans) -> list[str]:
    """What the user should know of a map in which places do not go with other visits of them."""
    loaded = scans()
    if loaded is None or not moves_in_plane(store):
        return []
    from mapmyworld.places.laser_nodes import nodes_at
    from mapmyworld.places.misplaced import misplaced_places

    found = misplaced_places(nodes_at(loaded, store.poses(), None, store.constraints()))
    loaded.scans.let_go()
    if not found.fell_apart:
        return []
    return [
        f"the map contradicts itself: {found.named(loaded.nodes)}; add or reject constraints "
        "there with mapmyworld edit"
    ]


def _solve(
    store: MapStore, constraints: Sequence[Judged], config: Config, progress: Progress
) -> SolvedGraph:
    nodes = store.nodes()
    progress.stage("optimise", len(nodes), "nodes")
    return solve_by_chains(nodes, constraints, moves_in_plane(store), config.graph)
