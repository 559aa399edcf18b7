"""Where in the whole map could this scan have been taken? Every place and heading is scored.

A beam search over two levels of the pyramid of branch and bound (Hess et al. 2016): squares of
the map are bounded at every heading, and the most promising are looked at cell by cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.kernels.map_search import best_in_blocks, block_bounds
from mapmyworld.localisation.known_place import KnownPlace
from mapmyworld.parallel import run_in_chunks

Array = NDArray[np.float64]
_LEVEL = 2  # of the pyramid at which squares are bounded: four cells wide
_MOST_BLOCKS = 20_000  # squares looked at cell by cell
_WORTH = 0.75  # of the best score, from which a place is a hypothesis
_DISTINCT = (1.0, 0.5)  # m and rad within which two hypotheses are one place
_STEPS = (0.01, 0.1)  # rad between headings: finest and coarsest


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """Poses at which the map explains a scan, best first."""

    poses: Array
    """(K, 3)."""
    scores: Array
    """(K,) mean likelihood of the scan's points, 0 to 1."""


def search_map(place: KnownPlace, points: Array, config: Config) -> Hypotheses:
    """The best poses of points (N, 2) in the whole map; none where there are no points."""
    grid = place.surfaces
    if len(points) == 0:
        return Hypotheses(np.zeros((0, 3)), np.zeros(0))
    far = float(np.percentile(np.hypot(*points.T), 80))
    step = float(np.clip(2.0 * grid.resolution / max(far, 1.0), *_STEPS))
    angles = np.arange(-np.pi, np.pi, step)
    blocks = _blocks(place)
    bounds = np.zeros((len(angles), len(blocks)), np.float32)

    def bound(first: int, last: int) -> None:
        block_bounds(
            first, last, grid.likelihoods(_LEVEL), grid.margin, blocks, points, angles,
            grid.resolution, bounds,
        )  # fmt: skip

    run_in_chunks(bound, len(angles), config.threads)
    flat = bounds.ravel()
    few = min(_MOST_BLOCKS, len(flat))
    chosen = np.argpartition(-flat, few - 1)[:few]
    chosen = np.sort(chosen[flat[chosen] >= 0.5 * flat[chosen].max()])
    turns, which = np.divmod(chosen, len(blocks))
    best = np.zeros((len(chosen), 3))

    def look(first: int, last: int) -> None:
        best_in_blocks(
            first, last, grid.likelihoods(0), grid.margin, 1 << _LEVEL, blocks[which], turns,
            points, angles, grid.resolution, best,
        )  # fmt: skip

    run_in_chunks(look, len(chosen), config.threads)
    worth = np.flatnonzero(best[:, 0] >= _WORTH * best[:, 0].max())
    order = worth[np.argsort(-best[worth, 0], kind="stable")]
    order = order[: config.localisation.particles]
    xy = grid.corner + best[order, 1:] * grid.resolution
    return Hypotheses(np.column_stack([xy, angles[turns[order]]]), best[order, 0])


def _blocks(place: KnownPlace) -> NDArray[np.int64]:
    """Lower left cells (B, 2), in the search's grid, of squares that hold a free cell."""
    grid, side = place.surfaces, 1 << _LEVEL
    rows, columns = np.nonzero(place.cells == 0)
    middles = place.corner + (np.stack([columns, rows], axis=1) + 0.5) * place.resolution
    cells = np.floor((middles - grid.corner) / (side * grid.resolution)).astype(np.int64)
    return np.unique(cells, axis=0) * side


def distinct_places(found: Hypotheses, pose: Array, most: int) -> Array:
    """The best hypotheses (K, 3) that differ from a pose (3,) and from each other."""
    chosen = [np.asarray(pose)]
    left = np.arange(len(found.poses))
    while len(left) and len(chosen) <= most:
        off = found.poses[left] - chosen[-1]
        near = np.hypot(off[:, 0], off[:, 1]) < _DISTINCT[0]
        left = left[~(near & (np.abs(wrap_angle(off[:, 2])) < _DISTINCT[1]))]
        if len(left):
            chosen.append(found.poses[left[0]])
    return np.array(chosen[1 : most + 1]).reshape(-1, 3)


def elsewhere(found: Hypotheses, pose: Array, distance: float) -> tuple[float, Array | None]:
    """Score and pose (3,) of the best hypothesis farther than `distance` metres from `pose` (3,).

    Score 0 and None if there is none.
    """
    apart = np.hypot(*(found.poses[:, :2] - pose[:2]).T)
    far = np.flatnonzero(apart > distance)
    if len(far) == 0:
        return 0.0, None
    return float(found.scores[far[0]]), found.poses[far[0]]
