"""The stage that asks of every node: have we been here before?"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.types import Constraint, MapStore, Poses, Progress

if TYPE_CHECKING:
    from mapmyworld.places.laser_nodes import NodeScans


LoadScans = Callable[[], "NodeScans | None"]
"""Gives the nodes' laser scans, made ready once; None for a log without a laser."""


Finder = Callable[[MapStore, Config, Progress], list[Constraint]]
"""Looks for constraints; gives none where its sensor or its setting is not there."""


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

    `words`: a vocabulary, number -> descriptor, to be used instead of one learned from the log.
    """
    for find in _finders():
        store.add_constraints(find(store, config, progress))
    add_closures(store, None, config, progress, scans, words)
    _check_wheels(store, progress)


def _finders() -> tuple[Finder, ...]:
    """Who looks once over the tracked nodes; what they find may be of a kind of its own."""
    from mapmyworld.places.markers import find_markers

    return (find_markers,)


def _check_wheels(store: MapStore, progress: Progress) -> None:
    """Says what images think of the recorded odometry, where both are there."""
    if store.tracked_frames().odom_from_base is None:
        return
    from mapmyworld.places.wheel_check import check_wheels

    check = check_wheels(store.nodes(), store.constraints())
    lines = () if check is None else check.lines()
    store.put("wheels", {"notes": lines})
    for line in lines:
        progress.note(line)


def add_closures(
    store: MapStore,
    poses: Poses | None,
    config: Config,
    progress: Progress,
    scans: LoadScans,
    words: Mapping[int, NDArray[np.uint8]] | None = None,
    since: int = 0,
) -> int:
    """Tries what has not been tried, from solved poses where there are some; how many were new.

    Scans of nodes with ids before `since` are not compared with each other.
    """
    found = []
    loaded = scans()
    if loaded is not None:
        from mapmyworld.places.laser_closures import find_laser_closures

        found += find_laser_closures(store, poses, config, progress, loaded, since)
    if has_images(store):
        from mapmyworld.places.visual_closures import find_visual_closures

        found += find_visual_closures(store, poses, config, progress, words)
    store.add_constraints(found)
    return sum(constraint.accepted for constraint in found)


def has_images(store: MapStore) -> bool:
    """Whether nodes keep images with depth."""
    return any(store.node_data(node.id, features=False).images for node in store.nodes()[:20])


def has_scans(store: MapStore) -> bool:
    """Whether tracked frames keep scans."""
    return next(iter(store.scans(range(20))), None) is not None
