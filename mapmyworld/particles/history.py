"""How a filter went: sample sizes, resamplings, loops, and the tree of paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.particles.filter import Generation

_KNOWN = 2.0  # m from an older place within which the robot is back there
_AWAY = 15.0  # m of path after which a place counts as older
_BRANCHES = 20_000  # segments of paths that are gathered,
_SHOWN = 5000  # and kept for the picture, about


def summary_of(
    generations: Sequence[Generation], path: NDArray[np.float64], frames: NDArray[np.int64]
) -> dict[str, Any]:
    """What `inspect map` shows of a filter that has run, as JSON values.

    `path` (K, 3) is the best particle's, x, y, yaw in the map; `frames` (K,) are those of updates.
    """
    particles = np.array([len(g.x) for g in generations], np.int64)
    effective = np.array([g.effective for g in generations]) / particles
    loops = [int(frames[k]) for k in loops_reentered(path)]
    return {
        "updates": len(generations),
        "particles_least": int(particles.min()),
        "particles_most": int(particles.max()),
        "effective_mean": float(np.mean(effective)),
        "effective_least": float(np.min(effective)),
        "resamplings": sum(g.resampled for g in generations),
        "loops_reentered": len(loops),
        "loop_frames": loops,
    }


def paths_of(generations: Sequence[Generation], path: NDArray[np.float64]) -> dict[str, list[Any]]:
    """What a picture of the paths needs, as JSON values rounded to centimetres.

    Pieces of all particles' paths, also of those that died out; the best one's `path` (K, 3), and
    where on it that came back to a place it had left.
    """
    branches = _branches(generations)
    thinned = branches[:: max(1, len(branches) // _SHOWN)]
    return {
        "branches": _rounded(thinned),
        "path": _rounded(path[:, :2]),
        "loops": _rounded(path[loops_reentered(path), :2]),
    }


def _rounded(places: NDArray[np.floating]) -> list[Any]:
    return list(np.round(places.astype(np.float64), 2).tolist())


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
