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
from mapmyworld.places.drift_priors import DriftPrior
from mapmyworld.places.laser_candidates import FIRST_WINDOW
from mapmyworld.places.laser_nodes import LaserNodes, spaced
from mapmyworld.places.laser_submaps import place_around
from mapmyworld.registration.place_evidence import FORTH, Hypothesis, Place, needed_evidence
from mapmyworld.registration.scan_search import evidence_elsewhere
from mapmyworld.types import Judge, Judged, ScanMatch, Verdict, Why

Around = Callable[[int], Place]
"""What was seen around a node."""


def reject_aliases(
    nodes: LaserNodes, priors: Sequence[DriftPrior], closures: Sequence[Judged], around: Around,
    config: Config, size: int,
) -> list[Judged]:  # fmt: skip
    """The closures of pairs with these priors, those rejected for which another place is as likely.

    Places are `size` times as long as others.
    """
    wanted = _places_to_look_at(nodes, priors, closures, config, size)

    def look(at: tuple[int, list[int]]) -> list[tuple[int, float]]:
        spot, which = at
        place = place_around(nodes, spot, config, size)
        return [
            (k, _second_best(nodes, place, spot, priors[k], around, closures[k])) for k in which
        ]

    second_bests = [0.0] * len(closures)
    for scores in in_threads(look, wanted.items(), config.threads):
        for k, score in scores:
            second_bests[k] = max(second_bests[k], score)
    return [
        _doubted(c, second_best) if second_best > 0 else c
        for c, second_best in zip(closures, second_bests, strict=True)
    ]


def _places_to_look_at(
    nodes: LaserNodes, priors: Sequence[DriftPrior], closures: Sequence[Judged], config: Config,
    size: int,
) -> dict[int, list[int]]:  # fmt: skip
    """Place along the path -> closures that it may second best."""
    places, path = config.places, nodes.path
    spots = spaced(path, size * places.laser_submap)
    itself = 2.0 * places.laser_submap
    found: dict[int, list[int]] = {}
    for k, prior in enumerate(priors):
        if closures[k].accepted:
            a, b = prior.earlier, prior.later
            reach, _ = prior.window(FIRST_WINDOW)
            apart = np.abs(path[spots] - path[a])
            near = (
                (apart > places.laser_spacing) & (apart <= reach) & (path[spots] < path[b] - itself)
            )
            for spot in spots[near].tolist():
                found.setdefault(spot, []).append(k)
    return found


def _second_best(
    nodes: LaserNodes, place: Place, spot: int, prior: DriftPrior, around: Around, closure: Judged
) -> float:
    """Evidence, in points, that what was seen around the later node lies around `spot` instead.

    0 where it is too little to be as likely.
    """
    a, b = prior.earlier, prior.later
    measured = matrix_to_planar(closure.i_from_j)
    spot_from_a = between_planar(nodes.poses[spot], nodes.poses[a])
    distance, angle = prior.window(FIRST_WINDOW)
    here, there = compose_planar(spot_from_a, measured), around(b)
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
    best = Hypothesis(around(a).agreement_with(there, measured), prior.log(measured))
    led = prior.log(between_planar(spot_from_a, other))
    beyond = best.beyond(Hypothesis(second_best, led), place.submap.size)
    return second_best.evidence if beyond < place.submap.margin else 0.0


def _doubted(closure: Judged, second_best: float) -> Judged:
    numbers = {"second_best": second_best, "evidence": _measured(closure).evidence}
    return closure.judged(Verdict(Judge.LASER, False, Why.AMBIGUOUS_PLACE, numbers))


def _measured(closure: Judged) -> ScanMatch:
    assert isinstance(closure.source, ScanMatch)
    return closure.source
