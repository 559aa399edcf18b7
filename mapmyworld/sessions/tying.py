"""Loop closures between sessions that were found to join, where both saw the same."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.places.laser_nodes import nodes_at
from mapmyworld.places.session_closures import closures_between
from mapmyworld.places.session_joining import SessionPlaces
from mapmyworld.sessions.copying import Placed
from mapmyworld.stages.recognise import LoadScans
from mapmyworld.types import Judged, Poses


def tie_sessions(
    placed: Sequence[Placed], joined: Iterable[tuple[int, int]], scans: LoadScans, config: Config
) -> list[Judged]:
    """Closures by laser for every (earlier, later) of these, from where they were found to lie.

    The maps are as they were when they were finished, which no graph without their aligned scans
    gives again.
    """
    loaded = scans()
    if loaded is None:
        return []
    ids = np.array([p.new_id(node.id) for p in placed for node in p.session_map.nodes], np.int64)
    solved = np.concatenate([p.common_from_session_map @ p.session_map.solved for p in placed])
    number = np.repeat(np.arange(len(placed)), [len(p.session_map.nodes) for p in placed])
    nodes = nodes_at(loaded, Poses(ids, solved))
    nodes = replace(nodes, session=number[np.searchsorted(ids, nodes.ids)])
    maps = [
        SessionPlaces(nodes, np.flatnonzero(nodes.session == k), config) for k in range(len(placed))
    ]
    return [
        c
        for earlier, later in joined
        for c in closures_between(nodes, maps[earlier], maps[later], config)
    ]
