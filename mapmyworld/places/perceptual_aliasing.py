"""Perceptual aliasing: closures that another place nearby explains as well are rejected.

Where equal doors follow each other, the next one lies beyond the submap that a scan was found in,
and no second best shows. So it is looked for in the places along the path as well, as far as the
drift may reach, 15 m at most: places farther off are compared by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar
from mapmyworld.parallel import in_threads
from mapmyworld.places.laser_candidates import FIRST_WINDOW, drift_window
from mapmyworld.places.laser_nodes import LaserNodes, spaced
from mapmyworld.places.laser_submaps import place_around
from mapmyworld.registration.place_evidence import FORTH, Place, needed_evidence
from mapmyworld.registration.scan_search import evidence_elsewhere
from mapmyworld.types import Judge, Judged, ScanMatch, Verdict, Why

Pairs = Sequence[tuple[int, int]]
Around = Callable[[int], Place]
"""What was seen around a node."""


def reject_aliases(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged], around: Around, config: Config,
    size: int,
) -> list[Judged]:  # fmt: skip
    """The closures of these pairs, those rejected for which another place scores as well.

    Places are `size` times as long as others.
    """
    wanted = _places_to_look_at(nodes, pairs, closures, config, size)

    def look(at: tuple[int, list[int]]) -> list[tuple[int, float]]:
        spot, which = at
        place = place_around(nodes, spot, config, size)
        return [(k, _second_best(nodes, place, spot, pairs[k], around, closures[k])) for k in which]

    second_bests = [0.0] * len(closures)
    for scores in in_threads(look, wanted.items(), config.threads):
        for k, score in scores:
            second_bests[k] = max(second_bests[k], score)
    return [
        _doubted(c, second_best) if second_best > 0 else c
        for c, second_best in zip(closures, second_bests, strict=True)
    ]


def _places_to_look_at(
    nodes: LaserNodes, pairs: Pairs, closures: Sequence[Judged], config: Config, size: int
) -> dict[int, list[int]]:
    """Place along the path -> closures that it may second best."""
    places, path = config.places, nodes.path
    spots = spaced(path, size * places.laser_submap)
    itself = 2.0 * places.laser_submap
    found: dict[int, list[int]] = {}
    for k, (a, b) in enumerate(pairs):
        if closures[k].accepted:
            reach, _ = drift_window(nodes, a, b, FIRST_WINDOW)
            apart = np.abs(path[spots] - path[a])
            near = (
                (apart > places.laser_spacing) & (apart <= reach) & (path[spots] < path[b] - itself)
            )
            for spot in spots[near].tolist():
                found.setdefault(spot, []).append(k)
    return found


def _second_best(
    nodes: LaserNodes, place: Place, spot: int, pair: tuple[int, int], around: Around,
    closure: Judged,
) -> float:  # fmt: skip
    """Evidence, in points, that what was seen around the later node lies around `spot` instead.

    0 where it is too little to be as likely.
    """
    a, b = pair
    found = compose_planar(nodes.poses[a], matrix_to_planar(closure.i_from_j))
    distance, angle = drift_window(nodes, a, b, FIRST_WINDOW)
    here, there = between_planar(nodes.poses[spot], found), around(b)
    needed = needed_evidence(distance, angle)
    points = there.submap.scored
    other = evidence_elsewhere(
        points, place.grid, here, distance, angle, FORTH * needed, _measured(closure).score,
        place.submap.behind,
    )  # fmt: skip
    if other is None:
        return 0.0
    second_best = place.agreement_with(there, other)
    if second_best.evidence < needed:
        return 0.0
    agreement = around(a).agreement_with(there, matrix_to_planar(closure.i_from_j))
    return second_best.evidence if agreement.beyond(second_best) < place.submap.margin else 0.0


def _doubted(closure: Judged, second_best: float) -> Judged:
    numbers = {"second_best": second_best, "evidence": _measured(closure).evidence}
    return closure.judged(Verdict(Judge.LASER, False, Why.AMBIGUOUS_PLACE, numbers))


def _measured(closure: Judged) -> ScanMatch:
    assert isinstance(closure.source, ScanMatch)
    return closure.source
