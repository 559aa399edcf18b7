"""A whole log's features and poses as one graph: GraphSLAM's measurement constraints.

Thrun and Montemerlo, "The GraphSLAM algorithm with applications to large-scale mapping of urban
structures" (2006): features are nodes beside the poses, and are eliminated first. What remains
links only poses that saw a feature together, so it is factorised sparsely.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.graph.bundle import (
    Array,
    Blocks,
    Bundle,
    Indices,
    eliminated,
    explain,
    free_slots,
    linearise,
    moved_points,
    starts_of_points,
)
from mapmyworld.graph.cholesky import NotPositiveDefiniteError, factorise
from mapmyworld.graph.elimination import Symbolic, analyse
from mapmyworld.kernels.bundle import list_links, subtract_points_sparsely

_WIDTH = 2.0  # sigmas from which Huber's weights begin
_LINKS_AT_ONCE = 1 << 20  # pairs of cameras that are gathered before doubles among them go


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """What an adjustment of all features and poses came to."""

    bundle: Bundle
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class _Pattern:
    """Which free cameras are linked; the same at every step."""

    slots: Indices
    """(K,) number among the free cameras, -1 for fixed ones."""
    links: Indices
    """(B,) blocks on and below the diagonal, row by row: row * F + column."""
    columns: Indices
    """(B,)."""
    row_starts: Indices
    """(F + 1,) where each row's blocks begin."""
    symbolic: Symbolic

    def block_at(self, rows: Indices, columns: Indices) -> Indices:
        """Numbers of blocks that there are."""
        free = len(self.row_starts) - 1
        return np.asarray(np.searchsorted(self.links, rows * free + columns), np.int64)


def adjust_features(bundle: Bundle, *, rounds: int = 20) -> Adjusted:
    """Cameras and points of least robust cost, by Levenberg-Marquardt; the cost never grows."""
    pattern = _pattern_of(bundle)
    blocks, cost = linearise(bundle, _WIDTH)
    damping = 1e-5
    for _ in range(rounds):
        trial = _step(bundle, blocks, pattern, damping)
        if trial is None:
            damping *= 10.0
            continue
        trial_blocks, trial_cost = linearise(trial, _WIDTH)
        if trial_cost > cost:
            damping *= 10.0
            continue
        done = cost - trial_cost < 1e-5 * cost
        bundle, blocks, cost, damping = trial, trial_blocks, trial_cost, damping * 0.2
        if done:
            break
    return Adjusted(bundle, cost)


def _pattern_of(bundle: Bundle) -> _Pattern:
    slots = free_slots(bundle)
    count = int(np.count_nonzero(~bundle.fixed))
    links = np.union1d(np.arange(count) * (count + 1), _links_by_points(bundle, slots, count))
    if bundle.motions is not None:
        first, second = slots[bundle.motions.first], slots[bundle.motions.second]
        both = (first >= 0) & (second >= 0)
        measured = np.maximum(first, second)[both] * count + np.minimum(first, second)[both]
        links = np.union1d(links, measured)
    rows, columns = np.divmod(links, max(count, 1))
    row_starts = np.searchsorted(rows, np.arange(count + 1)).astype(np.int64)
    return _Pattern(slots, links, columns, row_starts, analyse(count, rows, columns, 6))


def _links_by_points(bundle: Bundle, slots: Indices, count: int) -> Indices:
    """(L,) links of free cameras that saw a point together, gathered a million sightings at once:
    a table of all pairs would fill the memory long before the poses do.
    """
    starts, slot_of = starts_of_points(bundle), slots[bundle.camera_of]
    longest = int(np.diff(starts).max(initial=0))
    keys = np.empty(max(_LINKS_AT_ONCE, longest**2), np.int64)
    found, point = np.zeros(0, np.int64), 0
    while point < len(bundle.points):
        point, filled = list_links(starts, slot_of, count, point, keys)
        found = np.union1d(found, keys[:filled])
    return found


def _step(bundle: Bundle, blocks: Blocks, pattern: _Pattern, damping: float) -> Bundle | None:
    """The bundle after one damped step; None where the equations have no solution."""
    scaled, inverse = eliminated(bundle, blocks, damping)
    free = np.flatnonzero(~bundle.fixed)
    own = blocks.cameras[free]
    reduced = np.zeros((len(pattern.links), 6, 6))
    diagonal = pattern.block_at(np.arange(len(free)), np.arange(len(free)))
    reduced[diagonal] = own + damping * own * np.eye(6) + 1e-6 * np.eye(6)
    gradient = blocks.camera_gradients[free].copy()
    _add_motions(bundle, blocks, pattern, reduced, gradient)
    slot_of = pattern.slots[bundle.camera_of]
    subtract_points_sparsely(
        starts_of_points(bundle),
        slot_of,
        blocks.cross,
        scaled,
        pattern.row_starts,
        pattern.columns,
        reduced,
    )
    explain(bundle, blocks, scaled, slot_of, gradient)
    try:
        factors = factorise(pattern.symbolic, reduced)
    except NotPositiveDefiniteError:
        return None
    tangents = np.zeros((len(bundle.cameras), 6))
    tangents[free] = -factors.solve(gradient.ravel()).reshape(-1, 6)
    points = moved_points(bundle, blocks, inverse, tangents)
    return replace(bundle, cameras=bundle.cameras @ se3_exp(tangents), points=points)


def _add_motions(
    bundle: Bundle, blocks: Blocks, pattern: _Pattern, reduced: Array, gradient: Array
) -> None:
    """Adds what measured motions between cameras say."""
    if blocks.motions is None or bundle.motions is None:
        return
    first, second = pattern.slots[bundle.motions.first], pattern.slots[bundle.motions.second]
    aa, bb, ba, ga, gb = blocks.motions
    for ends, own, pull in ((first, aa, ga), (second, bb, gb)):
        free = ends >= 0
        np.add.at(reduced, pattern.block_at(ends[free], ends[free]), own[free])
        np.add.at(gradient, ends[free], pull[free])
    both = (first >= 0) & (second >= 0)
    below = both & (second > first)
    above = both & (second < first)
    np.add.at(reduced, pattern.block_at(second[below], first[below]), ba[below])
    turned = np.swapaxes(ba[above], 1, 2)
    np.add.at(reduced, pattern.block_at(first[above], second[above]), turned)
