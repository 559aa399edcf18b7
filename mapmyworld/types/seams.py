"""The seams of the project as Protocols: sources of logs, stores of maps, and progress."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types.constraints import Judged, Poses
from mapmyworld.types.frames import Features, Node, NodeData, Scan, TrackedFrames
from mapmyworld.types.log_info import LogInfo
from mapmyworld.types.maps import OccupancyGrid
from mapmyworld.types.messages import RawMessage

# A stage's rank orders it in time; alternatives share one.
STAGE_RANKS: Mapping[str, int] = {
    "plan": 0,
    "track": 1,
    "recognise": 2,
    "fastslam": 2,
    "optimise": 3,
    "judge": 4,
    "map": 5,
}


class LogSource(Protocol):
    """A recorded log. `messages` may be called again and gives the same messages each time."""

    def info(self) -> LogInfo:
        """What is in the log; containers of messages are read through for it, once."""

    def content_hash(self) -> str:
        """Hexadecimal digest of the log's bytes."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Messages of `topics` (all when None) in log-time order, ties in file order.

        Damaged parts are skipped; the `problems` of `info` then indicate what is missing.
        """

    def let_go(self) -> None:
        """Gives back the memory of what would have to be read again."""


class Progress(Protocol):
    """Reported what is going on; draws nothing itself unless it is the command line's."""

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None:
        """A stage begins; `total` in `unit`s ("s" of log time, "nodes", ...)."""

    def update(self, done: float) -> None:
        """So much of the stage's total is done."""

    def note(self, message: str) -> None:
        """Something the user should know: a warning, a decision, a loss."""


class MapStore(Protocol):
    """A map in the making and the finished map. Written while the log streams."""

    def stage_done(self, stage: str, inputs: str | None) -> bool:
        """Whether `stage` was finished with these very inputs (a hash); None is any."""

    def write_stage(self, stage: str, inputs: str) -> AbstractContextManager[None]:
        """Clears what `stage` and all later stages wrote; on a clean exit records it as done.

        Left by an exception, what was written so far stays, readable, and the stage not done.
        """

    def extend_stage(self, stage: str, inputs: str) -> AbstractContextManager[None]:
        """Like `write_stage`, but nothing is cleared: more is added to what the stage wrote."""

    def get(self, key: str) -> Any:
        """The JSON value kept under `key`; None when absent.

        Raises `MapError` where it is damaged.
        """

    def put(self, key: str, value: Any) -> None:
        """Keeps a JSON value: plan, diagnosis, versions, ..."""

    def add_node(self, node: Node, data: NodeData) -> None:
        """A node and its raw material; nodes come in the order of their ids."""

    def nodes(self) -> tuple[Node, ...]:
        """All nodes by id."""

    def node_data(self, node_id: int, *, features: bool = True) -> NodeData:
        """One node's data, read without touching others'; its features only where wanted.

        Raises `MapError` where there is no such node, or its data are damaged.
        """

    def add_scan(self, frame: int, scan: Scan) -> None:
        """The scan of the tracked frame with this index (nodes' and others' alike)."""

    def scans(self, frames: Sequence[int] | NDArray[np.int64]) -> Iterator[tuple[int, Scan]]:
        """The scans of these frames (K,), ascending; frames without a scan are passed over."""

    def set_tracked_frames(self, frames: TrackedFrames) -> None:
        """Every tracked moment at once, when tracking has ended."""

    def tracked_frames(self) -> TrackedFrames:
        """Every tracked moment; none before tracking has ended."""

    def add_constraints(self, constraints: Sequence[Judged]) -> None:
        """Constraints that were tried, after those that are there."""

    def judge(self, constraints: Sequence[Judged]) -> None:
        """What `constraints` gave, in that order, with further verdicts; behind it new ones."""

    def constraints(self) -> tuple[Judged, ...]:
        """Every constraint that was tried, in the order in which it was added.

        Those that a better measurement superseded are kept, and left out here.
        """

    def set_features(self, node_id: int, features: Features) -> None:
        """The features of a node's images."""

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        """The vocabulary: word id -> descriptor (D,)."""

    def words(self) -> dict[int, NDArray[Any]]:
        """The vocabulary, word id -> descriptor (D,); empty without one."""

    def set_poses(self, poses: Poses) -> None:
        """The optimised poses of nodes and landmarks."""

    def poses(self) -> Poses | None:
        """The optimised poses; None before the graph was solved."""

    def set_frame_poses(self, map_from_frame: NDArray[np.float64]) -> None:
        """Final pose (F, 4, 4) of every tracked frame."""

    def frame_poses(self) -> NDArray[np.float64] | None:
        """Final pose (F, 4, 4) of every tracked frame; None before the graph was solved."""

    def set_grid(self, grid: OccupancyGrid) -> None:
        """The occupancy grid."""

    def grid(self) -> OccupancyGrid | None:
        """The occupancy grid; None before it was drawn. Raises `MapError` where it is damaged."""
