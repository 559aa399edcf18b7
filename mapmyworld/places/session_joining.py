"""Session joining: components that tracking losses divide, joined where they fit in one way only.

Across a loss the relative pose is unknown, so one place that fits is not enough: a bare hall is the
same after half a turn. What the later component saw is laid into the map of the earlier one, as
the closures want it and as every other pose that fits wants it; and into its own, for what looks
like itself elsewhere fits twice wherever it fits. Where another pose explains it as well, and
nothing that was seen contradicts it, the components stay apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    compose_planar,
    invert_planar,
    matrix_to_planar,
)
from mapmyworld.places.component_maps import component_map, view_around
from mapmyworld.places.laser_candidates import drift_window
from mapmyworld.places.laser_nodes import Index, LaserNodes, spaced
from mapmyworld.places.submap_verification import (
    SAME,
    Seen,
    Window,
    apart_by,
    is_as_good,
    is_met,
    laid,
    most_supported,
    second_best_move,
)
from mapmyworld.types import Constraint, Judge, Judged, Verdict, Why

Array = NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]
_OPEN = 1.0  # rad of heading that must be open, or nothing is ambiguous
_SPACING = 2.0  # m of path between places that are laid into the other component's map
_AROUND = 24.0  # m of path to each side of the closures within which they are
_MAPPED = 0.5  # m of path between scans that maps are made of
_SIGHT = 30.0  # m beyond the reach of a search that maps cover
_MOST = 24  # such places of a component, at most

_UNMET = Verdict(Judge.LASER, False, Why.SUBMAPS_DISAGREE)
_LESS = Verdict(Judge.LASER, False, Why.LESS_EXPLAINED)


def reject_ambiguous_joins(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged], config: Config, widest: float
) -> list[Judged]:
    """The closures of these pairs; those that join two components ambiguously are rejected."""
    result = list(closures)
    for which in _joins(nodes, pairs, closures):
        for k, doubt in _doubts(nodes, pairs, closures, which, config, widest):
            result[k] = closures[k].judged(doubt)
    return result


def _joins(nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged]) -> list[list[int]]:
    """Accepted closures between components that nothing else ties, two components at a time."""
    found: dict[tuple[int, int], list[int]] = {}
    for k, (a, b) in enumerate(pairs):
        components = int(nodes.component[a]), int(nodes.component[b])
        if closures[k].accepted and components[0] != components[1]:
            found.setdefault(components, []).append(k)
    return list(found.values())


def _doubts(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged], which: list[int],
    config: Config, widest: float,
) -> list[tuple[int, Verdict]]:  # fmt: skip
    """Number of each closure that is not believed, and why."""
    a, b = (np.array([pairs[k][end] for k in which]) for end in (0, 1))
    spots = _spots(nodes, b)
    window = _window(nodes, int(a[0]), int(b[0]), spots, config, widest)
    if window[1] < _OPEN:
        return []
    moves = {k: _move(nodes, pairs[k], closures[k]) for k in which}
    middle = nodes.poses[spots[len(spots) // 2]]
    earlier = _seen(nodes, _spots(nodes, a), nodes.poses[spots], window, config)
    later = _seen(nodes, spots, nodes.poses[spots], window, config)
    best = _best(earlier, later, list(moves.values()), window, middle)
    doubt = _doubt(earlier, later, best, window, middle)
    if doubt is not None:
        return [(k, doubt) for k in which]
    held = next(pairs[k] for k, move in moves.items() if move is best)
    misses = {k: apart_by(best, move, nodes.poses[pairs[k][1]]) for k, move in moves.items()}
    agree = {k: _agrees(nodes, pairs[k], held, miss, config) for k, miss in misses.items()}
    return [(k, _LESS) for k, agrees in agree.items() if not agrees]


def _best(
    earlier: Seen, later: Seen, moves: Sequence[Array], window: Window, middle: Array
) -> Array:
    """The move that is supported most; one within the window, unless another explains more."""
    within = [_is_within(apart_by(np.zeros(3), move, middle), window) for move in moves]
    near, far = (
        [move for move, own in zip(moves, within, strict=True) if own is wanted]
        for wanted in (True, False)
    )
    if not near or not far:
        return most_supported(earlier, later, moves)
    best, other = most_supported(earlier, later, near), most_supported(earlier, later, far)
    as_good = is_as_good(laid(earlier, later, other), laid(earlier, later, best))
    return best if as_good else other


def _doubt(
    earlier: Seen, later: Seen, best: Array, window: Window, middle: Array
) -> Verdict | None:
    """Why two components are not believed to lie as this move brings them; None if they are."""
    if not is_met(laid(earlier, later, best)):
        return _UNMET
    second_best = second_best_move(earlier, later, best, window)
    if second_best is None:  # what looks like itself elsewhere fits twice wherever it fits
        turned = second_best_move(None, later, np.zeros(3), (2.0 * window[0], window[1]))
        second_best = None if turned is None else compose_planar(best, turned)
    return None if second_best is None else _ambiguous(apart_by(best, second_best, middle))


def _spots(nodes: LaserNodes, ends: Index) -> Index:
    """Some places every few metres around these ends of closures, in their component."""
    spots = spaced(nodes.path, _SPACING)
    near = np.abs(nodes.path[spots][:, None] - nodes.path[ends]).min(axis=1) <= _AROUND
    spots = spots[near & (nodes.component[spots] == nodes.component[ends[0]]) & nodes.sees[spots]]
    spots = ends if len(spots) == 0 else spots
    return np.asarray(spots[:: -(-len(spots) // _MOST)], np.int64)


def _seen(nodes: LaserNodes, spots: Index, about: Array, window: Window, config: Config) -> Seen:
    """What was seen from these places, and the map of their component around poses (N, 3)."""
    rows = _mapped(nodes, int(nodes.component[spots[0]]), about, window[0] + _SIGHT)
    views = [view_around(nodes, spot, config) for spot in spots.tolist()]
    return Seen(nodes.poses[spots], views, component_map(nodes, rows))


def _window(
    nodes: LaserNodes, a: int, b: int, spots: Index, config: Config, widest: float
) -> Window:
    """Metres and radians by which the later component may be off, as seen from the earlier one."""
    last, first = nearest_ends(nodes, a, b)
    distance, angle = drift_window(nodes, last, first, config, np.inf)
    far = np.hypot(*(nodes.poses[spots, :2] - nodes.poses[first, :2]).T).max()
    return min(distance + 2.0 * np.sin(angle / 2.0) * float(far), widest), angle


def nearest_ends(nodes: LaserNodes, a: int, b: int) -> tuple[int, int]:
    """The ascending two nodes, one of the component of each, with the least path between them."""
    one, other = (np.flatnonzero(nodes.component == nodes.component[k]) for k in (a, b))
    after = np.searchsorted(one, other).clip(1, max(len(one) - 1, 1))
    near = one[np.stack([after - 1, after.clip(0, len(one) - 1)])]
    gaps = np.abs(nodes.path[near] - nodes.path[other])
    side, row = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    ends = sorted((int(near[side, row]), int(other[row])))
    return ends[0], ends[1]


def _mapped(nodes: LaserNodes, component: int, about: Array, reach: float) -> Index:
    """Nodes of a component, not too far from these poses (S, 3), whose scans make a map of it."""
    rows = spaced(nodes.path, _MAPPED)
    rows = rows[(nodes.component[rows] == component) & nodes.sees[rows]]
    middle = about[:, :2].mean(axis=0)
    reach += float(np.hypot(*(about[:, :2] - middle).T).max())
    near = np.hypot(*(nodes.poses[rows, :2] - middle).T) <= reach
    return np.asarray(rows[near], np.int64)


def _move(nodes: LaserNodes, pair: tuple[int, int], closure: Constraint) -> Array:
    """(3,) by which the closure moves the later component, in the frame of the poses."""
    a, b = pair
    there = compose_planar(nodes.poses[a], matrix_to_planar(closure.i_from_j))
    return compose_planar(there, invert_planar(nodes.poses[b]))


def _is_within(apart: Array, window: Window) -> bool:
    return bool(np.abs(apart[:2]).max() <= window[0] and abs(apart[2]) <= window[1])


def _agrees(
    nodes: LaserNodes, pair: tuple[int, int], held: tuple[int, int], apart: Array, config: Config
) -> bool:
    """Whether two closures miss each other by no more than drift within the components explains."""
    driven = sum(abs(float(nodes.path[i] - nodes.path[j])) for i, j in zip(pair, held, strict=True))
    drift = driven * np.array([config.places.laser_drift, config.places.laser_drift_angle])
    return bool((np.array([np.hypot(*apart[:2]), abs(apart[2])]) <= SAME + drift).all())


def _ambiguous(apart: Array) -> Verdict:
    x, y, turn = apart.tolist()
    numbers = {"metres": float(np.hypot(x, y)), "degrees": float(abs(np.degrees(turn)))}
    return Verdict(Judge.LASER, False, Why.AMBIGUOUS_AFTER_LOSS, numbers)
