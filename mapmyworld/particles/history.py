"""How a filter went: sample sizes, resamplings, loops, and the tree of paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.particles.filter import Generation

_KNOWN = 2.0  # m from an older place within which the robot is back there
_AWAY = 15.0  # m of path after which a place counts as older
_BRANCHES = 20_000  # segments kept for the picture


@dataclass(frozen=True, slots=True, eq=False)
class FastSlamHistory:
    """One entry for each of the K updates of the filter."""

    frames: NDArray[np.int64]
    """(K,) index of the frame of each update."""
    particles: NDArray[np.int64]
    """(K,)."""
    effective: NDArray[np.float64]
    """(K,) effective sample size, before resampling."""
    resampled: NDArray[np.bool_]
    """(K,)."""
    loops: tuple[int, ...]
    """Frames at which the best particle came back to a place it had left."""
    branches: NDArray[np.float32]
    """(S, 2, 2) map frame: short pieces of all particles' paths, also of those that died out."""
    path: NDArray[np.float32]
    """(K, 2) of the best particle."""

    def summary(self) -> dict[str, Any]:
        """What `inspect map` shows, as JSON values."""
        return {
            "updates": len(self.frames),
            "particles_least": int(self.particles.min()),
            "particles_most": int(self.particles.max()),
            "effective_mean": float(np.mean(self.effective / self.particles)),
            "effective_least": float(np.min(self.effective / self.particles)),
            "resamplings": int(np.count_nonzero(self.resampled)),
            "loops_reentered": len(self.loops),
            "loop_frames": list(self.loops),
        }

    def paths(self) -> dict[str, list[Any]]:
        """What a picture of the paths needs, as JSON values rounded to centimetres."""
        thinned = self.branches[:: max(1, len(self.branches) // 5000)]
        return {
            "branches": np.round(thinned.astype(np.float64), 2).tolist(),
            "path": np.round(self.path.astype(np.float64), 2).tolist(),
            "loops": np.round(self._loop_places().astype(np.float64), 2).tolist(),
        }

    def _loop_places(self) -> NDArray[np.float32]:
        """(L, 2) where the best particle came back."""
        return self.path[np.isin(self.frames, np.array(self.loops, np.int64))]


def history_from_filter(
    generations: Sequence[Generation], path: NDArray[np.float64], frames: NDArray[np.int64]
) -> FastSlamHistory:
    """The history of a filter that has run.

    `path` (K, 3) is the best particle's, x, y, yaw in the map; `frames` (K,) are those of updates.
    """
    return FastSlamHistory(
        frames=np.asarray(frames, np.int64),
        particles=np.array([len(g.x) for g in generations], np.int64),
        effective=np.array([g.effective for g in generations]),
        resampled=np.array([g.resampled for g in generations], np.bool_),
        loops=tuple(int(frames[k]) for k in loops_reentered(path)),
        branches=_branches(generations),
        path=np.asarray(path[:, :2], np.float32),
    )


def loops_reentered(path: NDArray[np.float64]) -> list[int]:
    """Indices of a path (K, k) at which it meets itself after a way through new places.

    Its rows begin with x, y. It has met itself when an older place, at least 15 m of path ago, lies
    within 2 m; it must have been away from all of them for 15 m before that counts anew.
    """
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    pairs = cKDTree(path[:, :2]).query_pairs(_KNOWN, output_type="ndarray")
    older = pairs[travelled[pairs[:, 1]] - travelled[pairs[:, 0]] > _AWAY]
    back = np.zeros(len(path), np.bool_)
    back[older[:, 1]] = True
    found, last_back = [], 0.0
    for k in np.flatnonzero(back):
        if travelled[k] - last_back > _AWAY:
            found.append(int(k))
        last_back = travelled[k]
    return found


def _branches(generations: Sequence[Generation]) -> NDArray[np.float32]:
    """Pieces (S, 2, 2) of all paths, thinned in time to a bounded number."""
    total = sum(len(g.x) for g in generations)
    stride = max(1, -(-total // _BRANCHES))
    pieces = [np.zeros((0, 2, 2), np.float32)]
    for first in range(0, len(generations) - 1, stride):
        last = min(first + stride, len(generations) - 1)
        index = np.arange(len(generations[last].x))
        for k in range(last - 1, first - 1, -1):
            index = generations[k].ancestors[index]
        ends = np.stack([generations[first].x[index, :2], generations[last].x[:, :2]], axis=1)
        pieces.append(ends.astype(np.float32))
    return np.concatenate(pieces)
