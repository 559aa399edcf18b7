"""The tree of frames: every recorded transform, read ahead of everything else."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import invert
from mapmyworld.sensing.motion import MotionRecorder, RecordedMotion, is_place
from mapmyworld.types import TransformsMessage

_STILL_NS = 100_000_000  # between the times at which one that may yet move was seen to stand
_PLACES = 200  # look-ups that show how far one frame moves against another
_CONSTANT = 1e-6  # metres and radians within which a transform on /tf counts as fixed


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of older ROS versions."""
    return name.strip().lstrip("/")


def is_called(name: str, usual: Collection[str]) -> bool:
    """Whether a frame has one of these names, behind a robot's own too: r1/odom, r1_base_link."""
    return any(name == u or name.endswith((f"/{u}", f"_{u}")) for u in usual)


@dataclass(slots=True)
class Edge:
    """`parent_from_child`: one fixed motion, or a recorded one."""

    parent: str
    child: str
    first: NDArray[np.float64]
    """(4, 4)."""
    static: bool
    """Whether it came on the topic of static transforms."""
    count: int = 0
    still_ns: array[int] = field(default_factory=lambda: array("q"))
    """When it was seen to be `first`: the first and last time, and others between."""
    recorder: MotionRecorder | None = None
    motion: RecordedMotion | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether it has never moved."""
        return self.recorder is None and self.motion is None

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """The child's pose (4, 4) in the parent at a time; None where it is not known."""
        return self.first if self.motion is None else self.motion.at(stamp_ns)


class TransformTree:
    """Frames and the transforms between them; a frame has one parent, the one seen most."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], Edge] = {}
        self._parents: dict[str, Edge] = {}
        self.had_leading_slashes = False
        self.ignored: dict[str, str] = {}
        """Child frame -> why one of its parents was ignored."""

    def add(self, message: TransformsMessage) -> None:
        """What a message reports about frames; what is no place on earth is left out."""
        for transform in message.transforms:
            parent, child = transform.parent, transform.child
            self.had_leading_slashes |= parent.startswith("/") or child.startswith("/")
            names = frame_name(parent), frame_name(child)
            if names[0] == names[1] or not is_place(transform.parent_from_child):
                continue
            edge = self._edges.get(names)
            if edge is None:
                edge = Edge(*names, transform.parent_from_child, message.static)
                self._edges[names] = edge
            _record(edge, transform.stamp_ns, transform.parent_from_child)

    def finish(self) -> None:
        """Settles each frame's parent once everything has been read."""
        for edge in self._edges.values():
            if edge.recorder is not None:
                edge.motion, edge.recorder = edge.recorder.finish(), None
            chosen = self._parents.get(edge.child)
            if chosen is None or edge.count > chosen.count:
                self._parents[edge.child] = edge
            if chosen is not None:
                loser = chosen if self._parents[edge.child] is edge else edge
                self.ignored[edge.child] = (
                    f"{loser.parent} -> {loser.child} ({loser.count}x) ignored: "
                    f"{edge.child} has another parent, {self._parents[edge.child].parent}"
                )

    def frames(self) -> set[str]:
        """Names of all frames."""
        return {name for edge in self._edges.values() for name in (edge.parent, edge.child)}

    def edges(self) -> tuple[Edge, ...]:
        """Each frame with its parent."""
        return tuple(self._parents.values())

    def edge_to(self, child: str) -> Edge | None:
        """The edge by which a frame hangs on its parent."""
        return self._parents.get(child)

    def ancestors(self, frame: str) -> list[str]:
        """The frame and the frames above it, nearest first; stops at a cycle."""
        chain = [frame]
        while (edge := self._parents.get(chain[-1])) is not None and edge.parent not in chain:
            chain.append(edge.parent)
        return chain

    def chain(self, target: str, source: str) -> tuple[list[Edge], list[Edge]] | None:
        """Edges from `source` and from `target` up to their common ancestor, if they have one."""
        above_source, above_target = self.ancestors(source), self.ancestors(target)
        common = next((name for name in above_source if name in above_target), None)
        if common is None:
            return None
        up = [self._parents[name] for name in above_source[: above_source.index(common)]]
        down = [self._parents[name] for name in above_target[: above_target.index(common)]]
        return up, down

    def is_fixed(self, target: str, source: str) -> bool:
        """Whether nothing between the two frames moves."""
        chain = self.chain(target, source)
        return chain is not None and all(edge.is_fixed for part in chain for edge in part)

    def lookup(self, target: str, source: str, stamp_ns: int) -> NDArray[np.float64] | None:
        """`target_from_source` (4, 4) at a stamp; None when unconnected or not covered."""
        chain = self.chain(target, source)
        if chain is None:
            return None
        parts = [_climb(edges, stamp_ns) for edges in chain]
        if parts[0] is None or parts[1] is None:
            return None
        return np.asarray(invert(parts[1]) @ parts[0])

    def places(self, target: str, source: str) -> NDArray[np.float64]:
        """`target_from_source` (N, 4, 4) over the record, by its own stamps; N is 1 where nothing
        between the two moves, 0 where they are unconnected.
        """
        motions = [e.motion for part in self.chain(target, source) or () for e in part if e.motion]
        rarest = min(motions, key=len, default=None)
        stamps = [0] if rarest is None else rarest.stamps_ns[:: len(rarest) // _PLACES + 1]
        found = [self.lookup(target, source, int(stamp_ns)) for stamp_ns in stamps]
        return np.array([place for place in found if place is not None]).reshape(-1, 4, 4)


def _record(edge: Edge, stamp_ns: int, pose: NDArray[np.float64]) -> None:
    edge.count += 1
    if edge.recorder is not None:
        edge.recorder.add(stamp_ns, pose)
    elif edge.static:
        edge.first = pose
    elif np.abs(pose - edge.first).max() > _CONSTANT:
        edge.recorder = MotionRecorder()
        for still_ns in edge.still_ns:
            edge.recorder.add(still_ns, edge.first)
        edge.recorder.add(stamp_ns, pose)
    elif len(edge.still_ns) > 1 and 0 <= stamp_ns - edge.still_ns[-2] < _STILL_NS:
        edge.still_ns[-1] = stamp_ns  # of close times the last is kept
    else:
        edge.still_ns.append(stamp_ns)


def _climb(edges: list[Edge], stamp_ns: int) -> NDArray[np.float64] | None:
    """`ancestor_from_frame` through a chain of edges that starts at the frame."""
    total = np.eye(4)
    for edge in edges:
        step = edge.at(stamp_ns)
        if step is None:
            return None
        total = step @ total
    return total
