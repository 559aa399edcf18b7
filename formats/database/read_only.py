"""The writing half of a MapStore, for maps that are only read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.types import (
    Features,
    Judged,
    Mesh,
    Node,
    NodeData,
    OccupancyGrid,
    PointCloud,
    Poses,
    Scan,
    TrackedFrames,
)


class ReadOnly:
    """Refuses every change, with the suggestion."""

    path: Path

    def _refuse(self) -> NoReturn:
        raise MapError(
            f"{self.path}: is a database of RTAB-Map's and is never changed: write the result to"
            " another file with -o, or build a map of it with `mapmyworld build`"
        )

    def write_stage(self, stage: str, inputs: str) -> AbstractContextManager[None]:
        self._refuse()

    def extend_stage(self, stage: str, inputs: str) -> AbstractContextManager[None]:
        self._refuse()

    def put(self, key: str, value: Any) -> None:
        self._refuse()

    def add_node(self, node: Node, data: NodeData) -> None:
        self._refuse()

    def add_scan(self, frame: int, scan: Scan) -> None:
        self._refuse()

    def set_tracked_frames(self, frames: TrackedFrames) -> None:
        self._refuse()

    def add_constraints(self, constraints: Sequence[Judged]) -> None:
        self._refuse()

    def judge(self, constraints: Sequence[Judged]) -> None:
        self._refuse()

    def set_features(self, node_id: int, features: Features) -> None:
        self._refuse()

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        self._refuse()

    def set_poses(self, poses: Poses) -> None:
        self._refuse()

    def set_frame_poses(self, map_from_frame: NDArray[np.float64]) -> None:
        self._refuse()

    def set_grid(self, grid: OccupancyGrid) -> None:
        self._refuse()

    def set_parameters(self, parameters: Mapping[str, str]) -> None:
        self._refuse()

    def set_cloud(self, cloud: PointCloud) -> None:
        self._refuse()

    def set_mesh(self, mesh: Mesh) -> None:
        self._refuse()
