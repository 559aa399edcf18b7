"""Parts of the path that breaks divide, joined only where they fit together in one way.

Across a break nothing says how the robot stands, so that one place fits is not enough: a bare hall
is the same after half a turn. What the later part saw is laid into the map of the earlier one, as
the closures want it and as every other pose that fits wants it; and into its own, for what looks
like itself elsewhere fits twice wherever it fits. Where another pose explains it as well, and
nothing that was seen contradicts it, the parts stay apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    matrix_to_planar,
)
from mapmyworld.places.laser_candidates import drift_window
from mapmyworld.places.laser_nodes import Index, LaserNodes, spaced
from mapmyworld.places.part_maps import PartMap, View, part_map, view_around
from mapmyworld.registration.scan_search import pose_elsewhere
from mapmyworld.types import Constraint

Array = NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]
Window = tuple[float, float]
_SPACING = 2.0  # m of path between places that are laid into the other part's map
_AROUND = 24.0  # m of path to each side of the closures within which they are
_MAPPED = 0.5  # m of path between scans that maps are made of
_SIGHT = 30.0  # m beyond the reach of a search that maps cover
_MOST = 24  # such places of a part, at most
_LEAST = 0.5  # score from which a place may want another pose
_FITS = 0.6  # score from which a place fits
_HALF = 0.7  # score of a place that speaks neither for a pose nor against it
_AS_GOOD = 0.9  # share of the score from which it fits another pose as well
_SEEN = 0.4  # share of its points that must lie where the map was seen, to say anything
_ENOUGH = 0.3  # share of the places that fit, of which another pose must explain as much
_AGREED = 0.75  # share of the places seen that must agree with another pose
_SAME = np.array([1.0, 0.3])  # m and rad within which two moves are one

_TOO_FAR = "farther than the robot can have come unseen"
_UNMET = "what was seen around does not fit what had been seen there"
_LESS = "another closure between the same parts explains more of what was seen"


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What was seen from some places of a part, and the map that the part makes around."""

    poses: Array
    """(S, 3)."""
    views: list[View]
    """Of each place."""
    map: PartMap


def doubt_joins(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Constraint], config: Config, widest: float
) -> list[Constraint]:
    """The closures of these pairs, those rejected that join two parts in one of several ways."""
    result = list(closures)
    for which in _joins(nodes, pairs, closures):
        for k, reason in _doubts(nodes, pairs, closures, which, config, widest):
            result[k] = replace(closures[k], accepted=False, reason=reason)
    return result


def _joins(nodes: LaserNodes, pairs: Pairs, closures: Sequence[Constraint]) -> list[list[int]]:
    """Accepted closures between parts that nothing else ties, two parts at a time."""
    found: dict[tuple[int, int], list[int]] = {}
    for k, (a, b) in enumerate(pairs):
        parts = int(nodes.part[a]), int(nodes.part[b])
        if closures[k].accepted and parts[0] != parts[1]:
            found.setdefault(parts, []).append(k)
    return list(found.values())


def _doubts(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Constraint], which: list[int],
    config: Config, widest: float,
) -> list[tuple[int, str]]:  # fmt: skip
    """Number of each closure that is not believed, and why."""
    a, b = (np.array([pairs[k][end] for k in which]) for end in (0, 1))
    spots = _spots(nodes, b)
    window = _window(nodes, int(a[0]), int(b[0]), spots, config, widest)
    moves = {k: _move(nodes, pairs[k], closures[k]) for k in which}
    middle = nodes.poses[spots[len(spots) // 2]]
    likely = {k: m for k, m in moves.items() if _is_within(_apart(np.zeros(3), m, middle), window)}
    doubts = [(k, _TOO_FAR) for k in which if k not in likely]
    if not likely:
        return doubts
    earlier = _seen(nodes, _spots(nodes, a), nodes.poses[spots], window, config)
    later = _seen(nodes, spots, nodes.poses[spots], window, config)
    best = _most_supported(earlier, later, list(likely.values()))
    if not _is_met(_laid(earlier, later, best)):
        return doubts + [(k, _UNMET) for k in likely]
    rival = _rival(earlier, later, best, window)
    if rival is None:  # what looks like itself elsewhere fits twice wherever it fits
        best_of_itself, wide = np.zeros(3), (2.0 * window[0], window[1])
        rival = _rival(None, later, best_of_itself, wide)
        rival = None if rival is None else compose_planar(best, rival)
    if rival is not None:
        return doubts + [(k, _words(_apart(best, rival, middle))) for k in likely]
    held = next(pairs[k] for k, move in likely.items() if move is best)
    return doubts + [
        (k, _LESS)
        for k, move in likely.items()
        if not _agrees(nodes, pairs[k], held, _apart(best, move, nodes.poses[pairs[k][1]]), config)
    ]


def _spots(nodes: LaserNodes, ends: Index) -> Index:
    """Places about every few metres around these ends of closures, in their part; not too many."""
    spots = spaced(nodes.path, _SPACING)
    near = np.abs(nodes.path[spots][:, None] - nodes.path[ends]).min(axis=1) <= _AROUND
    spots = spots[near & (nodes.part[spots] == nodes.part[ends[0]]) & nodes.sees[spots]]
    spots = ends if len(spots) == 0 else spots
    return np.asarray(spots[:: -(-len(spots) // _MOST)], np.int64)


def _seen(nodes: LaserNodes, spots: Index, about: Array, window: Window, config: Config) -> _Seen:
    """What was seen from these places, and the map of their part around poses (N, 3)."""
    rows = _mapped(nodes, int(nodes.part[spots[0]]), about, window[0] + _SIGHT)
    views = [view_around(nodes, spot, config) for spot in spots.tolist()]
    return _Seen(nodes.poses[spots], views, part_map(nodes, rows))


def _window(
    nodes: LaserNodes, a: int, b: int, spots: Index, config: Config, widest: float
) -> Window:
    """Metres and radians by which the later part may be off, as seen from the earlier one."""
    last, first = nearest_ends(nodes, a, b)
    distance, angle = drift_window(nodes, last, first, config, np.inf)
    far = np.hypot(*(nodes.poses[spots, :2] - nodes.poses[first, :2]).T).max()
    return min(distance + 2.0 * np.sin(angle / 2.0) * float(far), widest), angle


def nearest_ends(nodes: LaserNodes, a: int, b: int) -> tuple[int, int]:
    """The ascending two nodes, one of the part of each, with the least path between them."""
    one, other = (np.flatnonzero(nodes.part == nodes.part[k]) for k in (a, b))
    after = np.searchsorted(one, other).clip(1, max(len(one) - 1, 1))
    near = one[np.stack([after - 1, after.clip(0, len(one) - 1)])]
    gaps = np.abs(nodes.path[near] - nodes.path[other])
    side, row = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    ends = sorted((int(near[side, row]), int(other[row])))
    return ends[0], ends[1]


def _mapped(nodes: LaserNodes, part: int, about: Array, reach: float) -> Index:
    """Nodes of a part, not too far from these poses (S, 3), whose scans make a map of it."""
    rows = spaced(nodes.path, _MAPPED)
    rows = rows[(nodes.part[rows] == part) & nodes.sees[rows]]
    middle = about[:, :2].mean(axis=0)
    reach += float(np.hypot(*(about[:, :2] - middle).T).max())
    near = np.hypot(*(nodes.poses[rows, :2] - middle).T) <= reach
    return np.asarray(rows[near], np.int64)


def _move(nodes: LaserNodes, pair: tuple[int, int], closure: Constraint) -> Array:
    """(3,) by which the closure moves the later part, in the frame of the poses."""
    a, b = pair
    there = compose_planar(nodes.poses[a], matrix_to_planar(closure.from_from_to))
    return compose_planar(there, invert_planar(nodes.poses[b]))


def _laid(earlier: _Seen | None, later: _Seen, move: Array) -> tuple[Array, Array]:
    """Scores and shares seen of every place of the later part, moved so, in the earlier one's map.

    And of those of the earlier part in the later one's. Without an earlier one: in its own.
    """
    there = later.map if earlier is None else earlier.map
    moved = compose_planar(move, later.poses)
    fits = [there.fit(view, at) for view, at in zip(later.views, moved, strict=True)]
    if earlier is not None:
        moved = compose_planar(invert_planar(move), earlier.poses)
        fits += [later.map.fit(view, at) for view, at in zip(earlier.views, moved, strict=True)]
    scores, seen = np.array(fits).T
    return scores, seen


def _most_supported(earlier: _Seen, later: _Seen, moves: Sequence[Array]) -> Array:
    """The move by which most of what was seen fits, and least does not."""
    middle, different = later.poses[len(later.poses) // 2], [moves[0]]
    for move in moves[1:]:
        if not any(_is_same(_apart(one, move, middle)) for one in different):
            different.append(move)
    if len(different) == 1:
        return different[0]
    laid = [_laid(earlier, later, move) for move in different]
    return different[int(np.argmax([(seen * (scores - _HALF)).sum() for scores, seen in laid]))]


def _is_met(laid: tuple[Array, Array]) -> bool:
    """Whether most places fit, of those that lie where the map was seen."""
    scores, seen = laid
    told = np.count_nonzero(seen >= _SEEN)
    return bool(np.count_nonzero((seen >= _SEEN) & (scores >= _FITS)) > 0.5 * told)


def _rival(earlier: _Seen | None, later: _Seen, move: Array, window: Window) -> Array | None:
    """Another move that explains as much as this one, and that nothing contradicts."""
    own = _laid(earlier, later, move)
    middle = later.poses[len(later.poses) // 2]
    tried: list[Array] = []
    for k in range(len(later.views)):
        other = _other_move(later.map if earlier is None else earlier.map, later, move, window, k)
        if other is None or any(_is_same(_apart(one, other, middle)) for one in tried):
            continue
        tried.append(other)
        if _is_as_good(own, _laid(earlier, later, other)):
            return other
    return None


def _is_as_good(own: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    """Whether places fit another way as well; those that fit neither way say nothing."""
    (scores, seen), (there, seen_there) = own, other
    fits = (seen >= _SEEN) & (scores >= _FITS)
    least = np.where(fits, _AS_GOOD * scores, _FITS)
    says_nothing = (seen >= _SEEN) & ~fits & (there < _FITS)
    told = (seen_there >= _SEEN) & ~says_nothing
    as_good = np.count_nonzero(told & (there >= least))
    return bool(as_good >= max(_ENOUGH * np.count_nonzero(fits), _AGREED * np.count_nonzero(told)))


def _other_move(there: PartMap, later: _Seen, move: Array, window: Window, k: int) -> Array | None:
    """The move that place `k` wants where it does not want this one."""
    about = later.poses[k]
    pose = compose_planar(move, about)
    other = pose_elsewhere(later.views[k].points, there.grid, about, *window, _LEAST, pose)
    return None if other is None else compose_planar(other, invert_planar(about))


def _is_within(apart: Array, window: Window) -> bool:
    return bool(np.abs(apart[:2]).max() <= window[0] and abs(apart[2]) <= window[1])


def _apart(move: Array, other: Array, middle: Array) -> Array:
    """(3,) from where the first move brings a pose to where the other does."""
    return between_planar(compose_planar(move, middle), compose_planar(other, middle))


def _agrees(
    nodes: LaserNodes, pair: tuple[int, int], held: tuple[int, int], apart: Array, config: Config
) -> bool:
    """Whether two closures miss each other by no more than drift within the parts explains."""
    driven = sum(abs(float(nodes.path[i] - nodes.path[j])) for i, j in zip(pair, held, strict=True))
    drift = driven * np.array([config.places.laser_drift, config.places.laser_drift_angle])
    return bool((np.array([np.hypot(*apart[:2]), abs(apart[2])]) <= _SAME + drift).all())


def _words(apart: Array) -> str:
    x, y, turn = apart.tolist()
    return (
        "ambiguous: what was seen after the break fits as well "
        f"{np.hypot(x, y):.1f} m and {abs(np.degrees(turn)):.0f} deg from there"
    )


def _is_same(apart: Array) -> bool:
    return bool(np.hypot(*apart[:2]) <= _SAME[0] and abs(apart[2]) <= _SAME[1])
