"""The stage that asks of every node: have we been here before?"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.decisions import decided_on
from mapmyworld.stages.kept import has_images, has_scans
from mapmyworld.types import Judged, MapStore, Progress

if TYPE_CHECKING:
    from mapmyworld.graph.solved_graph import SolvedGraph
    from mapmyworld.places.laser_nodes import NodeScans

LoadScans = Callable[[], "NodeScans | None"]
"""Gives the nodes' laser scans, made ready once; None for a log without a laser."""


def scan_loader(store: MapStore, config: Config) -> LoadScans:
    """A loader that makes the scans ready when first asked."""

    def load() -> NodeScans | None:
        if not has_scans(store):
            return None
        from mapmyworld.places.laser_nodes import load_node_scans

        return load_node_scans(store, config)

    return functools.cache(load)


def recognise(
    store: MapStore,
    config: Config,
    progress: Progress,
    scans: LoadScans,
    words: Mapping[int, NDArray[np.uint8]] | None = None,
) -> None:
    """Loop closures by images and by scans over the whole log, each with verdict and reason.

    `words`: a vocabulary, number -> descriptor (D,), used instead of one learned from the log.
    """
    if config.visual.markers:
        from mapmyworld.places.markers import find_markers

        store.add_constraints(find_markers(store, config, progress))
    loaded, found = scans(), []
    if loaded is not None:
        from mapmyworld.places.laser_nodes import joined_sessions, nodes_at
        from mapmyworld.places.laser_sections import closures_by_section
        from mapmyworld.places.session_closures import Pair, session_closures

        solve = functools.partial(solve_draft_of, store, config)
        found += closures_by_section(loaded, store.constraints(), solve, config, progress)
        # Those that join what a loss of tracking divides, two sessions after the other: each lies
        # as its closures hold it, and those that are joined are one.
        stored, apart = store.constraints(), set[Pair]()
        while (session := joined_sessions(loaded, found)).any():
            draft = solve_draft_of(store, config, [*stored, *found])
            nodes = nodes_at(loaded, draft.poses, None, draft.constraints)
            nodes = replace(nodes, session=session)
            joining = session_closures(nodes, config, progress, apart)
            if not joining:
                break
            found += joining
    if has_images(store):
        from mapmyworld.places.visual_closures import find_visual_closures

        found += find_visual_closures(store, None, config, progress, words)
    decided_on("closure", found)
    store.add_constraints(found)
    _check_wheels(store, progress, alone=loaded is None)


def solve_draft_of(
    store: MapStore, config: Config, constraints: Sequence[Judged], until: int | None = None
) -> SolvedGraph:
    """The graph of a store's nodes with these constraints, up to the node with the id `until`."""
    from mapmyworld.graph.chains import solve_draft
    from mapmyworld.sensing.plan import moves_in_plane

    return solve_draft(store.nodes(), constraints, moves_in_plane(store), config.graph, until)


def _check_wheels(store: MapStore, progress: Progress, *, alone: bool) -> None:
    """Compares the recorded odometry with images, where both are there.

    Where wheels `alone` reported the motion, and in a plane, it is calibrated by them.
    """
    if store.tracked_frames().odom_from_base is None:
        return
    from mapmyworld.places.wheel_check import check_wheels, corrected
    from mapmyworld.sensing.plan import moves_in_plane

    nodes = store.nodes()
    check = check_wheels(nodes, store.constraints())
    if check is not None and alone and moves_in_plane(store):
        store.judge(corrected(nodes, store.constraints(), check))
    lines = () if check is None else check.lines()
    store.put("wheels", {"notes": lines})
    for line in lines:
        progress.note(line)


def add_closures(
    store: MapStore,
    draft: SolvedGraph,
    config: Config,
    progress: Progress,
    scans: LoadScans,
    since: int = 0,
) -> int:
    """Tries what has not been tried, from solved poses; how many were new.

    Scans of nodes with ids before `since` are not compared with each other.
    """
    found, loaded = [], scans()
    if loaded is not None:
        from mapmyworld.places.laser_closures import find_laser_closures

        poses, tied = draft.poses, draft.constraints
        found += find_laser_closures(store, poses, config, progress, loaded, tied, since)
    if has_images(store):
        from mapmyworld.places.visual_closures import find_visual_closures

        found += find_visual_closures(store, draft.poses, config, progress, None)
    decided_on("closure", found)
    store.add_constraints(found)
    return sum(constraint.accepted for constraint in found)
