"""Submap verification: what was seen from two components, laid into each other's maps.

A move that brings the components together decides which places fit. Another move is as good if it
explains as much and nothing that was seen contradicts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.planar import between_planar, compose_planar, invert_planar
from mapmyworld.places.component_maps import ComponentMap, View
from mapmyworld.registration.scan_search import pose_elsewhere

Array = NDArray[np.float64]
Window = tuple[float, float]
"""Metres to each side and radians within which a component may be off."""
SAME = np.array([1.0, 0.3])
"""Metres and radians within which two moves are one."""
_LEAST = 0.5  # score from which a place may want another pose
_FITS = 0.6  # score from which a place fits
_HALF = 0.7  # score of a place that speaks neither for a pose nor against it
_AS_GOOD = 0.9  # share of the score from which it fits another pose as well
_SEEN = 0.4  # share of its points that must lie where the map was seen, to say anything
_ENOUGH = 0.3  # share of the places that fit, of which another pose must explain as much
_AGREED = 0.75  # share of the places seen that must agree with another pose


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What was seen from some places of a component, and its map around them."""

    poses: Array
    """(S, 3)."""
    views: list[View]
    """Of each place."""
    map: ComponentMap


def laid(earlier: Seen | None, later: Seen, move: Array) -> tuple[Array, Array]:
    """Scores and shares seen, both (K,), of the later places, moved, in the earlier's map.

    And of those of the earlier component in the later one's. Without an earlier one: in its own.
    `move` (3,) is earlier_from_later.
    """
    there = later.map if earlier is None else earlier.map
    moved = compose_planar(move, later.poses)
    fits = [there.fit(view, at) for view, at in zip(later.views, moved, strict=True)]
    if earlier is not None:
        moved = compose_planar(invert_planar(move), earlier.poses)
        fits += [later.map.fit(view, at) for view, at in zip(earlier.views, moved, strict=True)]
    scores, seen = np.array(fits).T
    return scores, seen


def most_supported(earlier: Seen, later: Seen, moves: Sequence[Array]) -> Array:
    """The move (3,) by which most of what was seen fits, and least does not."""
    middle, different = later.poses[len(later.poses) // 2], [moves[0]]
    for move in moves[1:]:
        if not any(is_same(apart_by(one, move, middle)) for one in different):
            different.append(move)
    if len(different) == 1:
        return different[0]
    fits = [laid(earlier, later, move) for move in different]
    return different[int(np.argmax([(seen * (scores - _HALF)).sum() for scores, seen in fits]))]


def is_met(laid: tuple[Array, Array]) -> bool:
    """Whether most places fit, of those that lie where the map was seen.

    `laid`: scores (K,) and shares seen (K,).
    """
    scores, seen = laid
    reported = np.count_nonzero(seen >= _SEEN)
    return bool(np.count_nonzero((seen >= _SEEN) & (scores >= _FITS)) > 0.5 * reported)


def second_best_move(
    earlier: Seen | None, later: Seen, move: Array, window: Window
) -> Array | None:
    """Another move (3,) that explains as much as this one, and that nothing contradicts."""
    own = laid(earlier, later, move)
    middle = later.poses[len(later.poses) // 2]
    tried: list[Array] = []
    for k in range(len(later.views)):
        other = _other_move(later.map if earlier is None else earlier.map, later, move, window, k)
        if other is None or any(is_same(apart_by(one, other, middle)) for one in tried):
            continue
        tried.append(other)
        if is_as_good(own, laid(earlier, later, other)):
            return other
    return None


def is_as_good(own: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    """Whether places fit another way as well; those that fit neither way do not count.

    Both ways by their scores (K,) and shares seen (K,).
    """
    (scores, seen), (there, seen_there) = own, other
    fits = (seen >= _SEEN) & (scores >= _FITS)
    least = np.where(fits, _AS_GOOD * scores, _FITS)
    fits_neither = (seen >= _SEEN) & ~fits & (there < _FITS)
    reported = (seen_there >= _SEEN) & ~fits_neither
    as_good = np.count_nonzero(reported & (there >= least))
    return bool(
        as_good >= max(_ENOUGH * np.count_nonzero(fits), _AGREED * np.count_nonzero(reported))
    )


def _other_move(
    there: ComponentMap, later: Seen, move: Array, window: Window, k: int
) -> Array | None:
    """The move that place `k` wants where it does not want this one."""
    about = later.poses[k]
    pose = compose_planar(move, about)
    other = pose_elsewhere(later.views[k].points, there.grid, about, *window, _LEAST, pose)
    return None if other is None else compose_planar(other, invert_planar(about))


def apart_by(move: Array, other: Array, middle: Array) -> Array:
    """(3,) from where `move` (3,) brings the pose `middle` (3,) to where `other` (3,) does."""
    return between_planar(compose_planar(move, middle), compose_planar(other, middle))


def is_same(apart: Array) -> bool:
    """Whether two moves so far `apart` (3,) are one."""
    return bool(np.hypot(*apart[:2]) <= SAME[0] and abs(apart[2]) <= SAME[1])
