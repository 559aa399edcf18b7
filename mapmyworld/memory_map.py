"""A map in memory: everything that `map.db` keeps, in dictionaries."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import (
    Features,
    Judged,
    Node,
    NodeData,
    OccupancyGrid,
    Poses,
    Scan,
    TrackedFrames,
    Verdict,
)
from mapmyworld.types.frames import nodes_as_frames
from mapmyworld.types.seams import STAGE_RANKS


class MemoryMap:
    """A `MapStore` that holds everything by the stage that wrote it; the latest is in force."""

    def __init__(self) -> None:
        self._rank: int | None = None
        self._stages: dict[str, str] = {}
        self._keys: dict[tuple[str, int], Any] = {}
        self._values: dict[tuple[str, int], Any] = {}
        self._nodes: dict[int, tuple[Node, NodeData]] = {}
        self._scans: dict[int, Scan] = {}
        self._constraints: dict[int, tuple[int, Judged]] = {}
        self._verdicts: list[tuple[int, int, Verdict]] = []
        self._features: dict[int, tuple[int, Features]] = {}
        self._words: dict[int, NDArray[Any]] = {}

    def __enter__(self) -> MemoryMap:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        pass

    def stage_done(self, stage: str, inputs: str | None) -> bool:
        return stage in self._stages and inputs in (None, self._stages[stage])

    @contextmanager
    def write_stage(self, stage: str, inputs: str) -> Iterator[None]:
        self._clear(STAGE_RANKS[stage])
        with self.extend_stage(stage, inputs):
            yield

    @contextmanager
    def extend_stage(self, stage: str, inputs: str) -> Iterator[None]:
        self._rank = STAGE_RANKS[stage]
        try:
            yield
            self._stages[stage] = inputs
        finally:
            self._rank = None

    def _clear(self, rank: int) -> None:
        self._stages = {s: i for s, i in self._stages.items() if STAGE_RANKS[s] < rank}
        self._keys = {at: v for at, v in self._keys.items() if at[1] < rank}
        self._values = {at: v for at, v in self._values.items() if at[1] < rank}
        self._constraints = {k: (r, c) for k, (r, c) in self._constraints.items() if r < rank}
        self._verdicts = [(r, k, verdict) for r, k, verdict in self._verdicts if r < rank]
        if rank <= STAGE_RANKS["track"]:
            self._nodes, self._scans = {}, {}
        if rank <= STAGE_RANKS["recognise"]:
            self._words = {}
            self._features = {
                node_id: (r, replace(features, words=None))
                for node_id, (r, features) in self._features.items()
                if r < rank
            }

    def _current_rank(self) -> int:
        if self._rank is not None:
            return self._rank
        return max((STAGE_RANKS[stage] for stage in self._stages), default=0)

    def get(self, key: str) -> Any:
        ranks = [rank for name, rank in self._keys if name == key]
        return self._keys[key, max(ranks)] if ranks else None

    def put(self, key: str, value: Any) -> None:
        if self._rank is None:
            self._keys = {at: v for at, v in self._keys.items() if at[0] != key}
        self._keys[key, -1 if self._rank is None else self._rank] = value

    def add_node(self, node: Node, data: NodeData) -> None:
        self._nodes[node.id] = (node, data)
        if data.features is not None:
            self.set_features(node.id, data.features)

    def nodes(self) -> tuple[Node, ...]:
        return tuple(self._nodes[node_id][0] for node_id in sorted(self._nodes))

    def node_data(self, node_id: int, *, features: bool = True) -> NodeData:
        found = self._features.get(node_id) if features else None
        return replace(self._nodes[node_id][1], features=found[1] if found else None)

    def add_scan(self, frame: int, scan: Scan) -> None:
        self._scans[frame] = scan

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        for frame in np.unique(np.asarray(frames, np.int64)).tolist():
            if frame in self._scans:
                yield frame, self._scans[frame]

    def set_tracked_frames(self, frames: TrackedFrames) -> None:
        self._set("tracked", frames)

    def tracked_frames(self) -> TrackedFrames:
        frames: TrackedFrames | None = self._get("tracked")
        return nodes_as_frames(self.nodes()) if frames is None else frames

    def add_constraints(self, constraints: Sequence[Judged]) -> None:
        first, rank = max(self._constraints, default=0) + 1, self._current_rank()
        self._constraints |= {k: (rank, c) for k, c in enumerate(constraints, first)}

    def judge(self, constraints: Sequence[Judged]) -> None:
        known, rank = self._in_force(), self._current_rank()
        for (k, before), judged in zip(known.items(), constraints[: len(known)], strict=True):
            self._verdicts += [(rank, k, v) for v in judged.verdicts[len(before.verdicts) :]]
        self.add_constraints(constraints[len(known) :])

    def constraints(self) -> tuple[Judged, ...]:
        return tuple(self._in_force().values())

    def _in_force(self) -> dict[int, Judged]:
        verdicts = defaultdict[int, list[Verdict]](list)
        for _, k, verdict in self._verdicts:
            verdicts[k].append(verdict)
        every = {k: c.judged(*verdicts[k]) for k, (_, c) in self._constraints.items()}
        return {k: c for k, c in every.items() if not c.is_superseded}

    def set_features(self, node_id: int, features: Features) -> None:
        rank = self._features[node_id][0] if node_id in self._features else self._current_rank()
        self._features[node_id] = (rank, features)

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        self._words = dict(sorted(words.items()))

    def words(self) -> dict[int, NDArray[Any]]:
        return dict(self._words)

    def set_poses(self, poses: Poses) -> None:
        self._set("poses", poses)

    def poses(self) -> Poses | None:
        found: Poses | None = self._get("poses")
        return found

    def set_frame_poses(self, map_from_frame: NDArray[np.float64]) -> None:
        self._set("frame poses", map_from_frame)

    def frame_poses(self) -> NDArray[np.float64] | None:
        found: NDArray[np.float64] | None = self._get("frame poses")
        return found

    def set_grid(self, grid: OccupancyGrid) -> None:
        self._set("grid", grid)

    def grid(self) -> OccupancyGrid | None:
        found: OccupancyGrid | None = self._get("grid")
        return found

    def _set(self, name: str, value: Any) -> None:
        rank = self._current_rank()
        self._values = {at: v for at, v in self._values.items() if at[0] != name or at[1] < rank}
        self._values[name, rank] = value

    def _get(self, name: str) -> Any:
        ranks = [rank for at, rank in self._values if at == name]
        return self._values[name, max(ranks)] if ranks else None
