"""Loop closures by scans alone: submap against submap, searched as far as the drift may reach."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    information_from_planar,
    planar_to_matrix,
)
from mapmyworld.kernels.laser_motion import FAINT, is_degenerate
from mapmyworld.parallel import in_threads
from mapmyworld.places.drift_priors import DriftPrior, drift_priors
from mapmyworld.places.laser_candidates import (
    EVERYWHERE,
    FIRST_WINDOW,
    MOST,
    Pairs,
    candidate_pairs,
    lost_pairs,
    pairs_about,
    untied,
)
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, nodes_at
from mapmyworld.places.laser_submaps import match_submaps, place_around, submap_members
from mapmyworld.places.perceptual_aliasing import reject_aliases
from mapmyworld.registration.place_evidence import FORTH, Hypothesis, Place, needed_evidence
from mapmyworld.registration.scan_matching import Match
from mapmyworld.registration.scan_search import APART, Found, are_one, search_evidence
from mapmyworld.types import (
    ConstraintKind,
    Judge,
    Judged,
    MapStore,
    Poses,
    Progress,
    ScanMatch,
    Verdict,
    Why,
)

_KEPT = 16  # places, for neighbours are compared with the same ones
_LONGER = 4  # times as long: submaps for what ordinary ones leave open
OPEN = Why.AMBIGUOUS_POSE, Why.AMBIGUOUS_PLACE, Why.DEGENERATE
"""What scans do not decide: longer submaps may, or the final poses."""
_AGREEMENT = np.diag([0.02**2, 0.02**2, 0.005**2])  # m^2 and rad^2 that two maps may differ by


def find_laser_closures(
    store: MapStore,
    poses: Poses,
    config: Config,
    progress: Progress,
    loaded: NodeScans,
    tied: Sequence[Judged] = (),
    since: int = 0,
) -> list[Judged]:
    """Every pair of places that was compared from optimised poses, with its verdict.

    The search reaches only a little, where the kind is `proximity`; and as far as tracking may be
    off where nothing was recognised for long. Places that `tied` closures join are not compared
    again, nor are nodes with ids before `since` with each other.
    """
    if len(loaded.nodes) < 2:
        return []
    nodes, constraints = nodes_at(loaded, poses, None, tied), store.constraints()
    known = {(c.from_id, c.to_id) for c in constraints}

    def untried(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
        ends = [(a, b, int(nodes.ids[a]), int(nodes.ids[b])) for a, b in pairs]
        return [(a, b) for a, b, i, j in ends if (i, j) not in known and j >= since]

    pairs = untried(untied(nodes, candidate_pairs(nodes, config, optimised=True), tied, config))
    progress.stage("loop closures by laser", len(pairs), "pairs")
    found = [
        replace(c, kind=ConstraintKind.PROXIMITY) for c in compare_places(nodes, pairs, config)
    ]
    for may_be_fault in (False, True):
        if may_be_fault and not loaded.doubted.any():
            break
        wide = nodes_at(loaded, poses, None, [*tied, *found])
        if may_be_fault:
            wide = replace(wide, drift=replace(wide.drift, faults=True))
        known |= {(c.from_id, c.to_id) for c in found}
        lost = untried(lost_pairs(wide, config))
        progress.stage("loop closures by laser", len(lost), "pairs")
        compared = compare_places(wide, lost, config, EVERYWHERE)
        known |= {(c.from_id, c.to_id) for c in compared}
        about = untried(pairs_about(wide, compared, config))
        found += [*compared, *compare_places(wide, about, config, EVERYWHERE)]
    return found


def compare_places(
    nodes: LaserNodes, pairs: Pairs, config: Config, widest: float = FIRST_WINDOW
) -> list[Judged]:
    """Each pair's closure, accepted or not, in the order of the pairs.

    The search goes as far as the drift, `widest` metres at most. What is ambiguous or degenerate is
    compared once more, with longer submaps: equal doors follow each other in equal distances for a
    while, seldom for a whole corridor.
    """
    priors = drift_priors(nodes, pairs)
    found = _compare_all(nodes, priors, config, widest, 1)
    unclear = [k for k, c in enumerate(found) if c.verdicts[-1].why in OPEN]
    again = _compare_all(nodes, [priors[k] for k in unclear], config, widest, _LONGER)
    for k, closure in zip(unclear, again, strict=True):
        if closure.accepted:
            found[k] = closure
    return found


def _compare_all(
    nodes: LaserNodes, priors: Sequence[DriftPrior], config: Config, widest: float, size: int
) -> list[Judged]:
    """The same with submaps of one size, `size` times as long as ordinary ones."""
    by_target: dict[int, list[int]] = {}
    for k, prior in enumerate(priors):
        by_target.setdefault(prior.earlier, []).append(k)

    @functools.lru_cache(maxsize=_KEPT)
    def around(b: int) -> Place:
        return place_around(nodes, b, config, size)

    @functools.cache  # few points, and most of a wide search needs no more of a place
    def scored(b: int) -> Array:
        return around(b).submap.scored

    def compare(target: tuple[int, list[int]]) -> list[Judged]:
        a, rows = target
        place = place_around(nodes, a, config, size)  # large: one a thread is held
        asked = [priors[k] for k in rows]
        return [_compare(nodes, place, prior, scored, around, config, widest) for prior in asked]

    found = in_threads(compare, by_target.items(), config.threads)
    places = [k for rows in by_target.values() for k in rows]
    by_place = dict(zip(places, (c for some in found for c in some), strict=True))
    closures = [by_place[k] for k in range(len(priors))]
    return reject_aliases(nodes, priors, closures, around, config, size)


def _compare(
    nodes: LaserNodes, place: Place, prior: DriftPrior, scored: Callable[[int], Array],
    around: Callable[[int], Place], config: Config, widest: float,
) -> Judged:  # fmt: skip
    size, (a, b, guess, _) = place.submap.size, prior
    distance, angle = prior.window(widest)
    searched, centre = distance, guess
    if widest == EVERYWHERE:  # is the robot at this place?
        centre, distance = np.array([0.0, 0.0, guess[2]]), config.places.laser_submap
        searched = min(searched, np.sqrt(MOST) * distance)
    needed = needed_evidence(searched, angle)
    found = search_evidence(
        scored(b), place.grid, centre, distance, angle, FORTH * needed, place.submap.behind
    )
    if found is None:
        verdict = Verdict(Judge.LASER, False, Why.NOTHING_IN_COMMON)
        return _constraint(nodes, a, b, guess, np.eye(3), ScanMatch(), verdict)
    pose, match, best, others = _likeliest(nodes, place, prior, around, found, needed, config)
    second_best = min(others, key=lambda other: best.beyond(other, size), default=None)
    source = ScanMatch(
        best.agreement.evidence, second_best.agreement.evidence if second_best else 0.0,
        best.beyond(second_best, size) if second_best else best.agreement.evidence,
        float(found.score), float(match.overlap), float(match.residual),
        float(np.hypot(*between_planar(guess, match.pose)[:2])),
    )  # fmt: skip
    verdict = _verdict(source, pose, match, needed, place.submap.margin)
    information: Array = np.eye(3)
    if verdict.accepted:
        information = closure_information(match)
        if size > 1:
            sections = [(k, submap_members(nodes, k, config, size)) for k in (a, b)]
            # What motions within them err by comes on top, and so many more closures share a scan.
            spread = np.linalg.inv(information) + nodes.drift.within(sections)
            information = np.asarray(np.linalg.inv(size * spread), np.float64)
    return _constraint(nodes, a, b, match.pose, information, source, verdict)


def _likeliest(
    nodes: LaserNodes, place: Place, prior: DriftPrior, around: Callable[[int], Place],
    found: Found, needed: float, config: Config,
) -> tuple[Array, Match, Hypothesis, list[Hypothesis]]:  # fmt: skip
    """Where b lies, seen from a: a pose (3,), the match from there, and others with the evidence
    that is `needed`, in points.

    The search knows of no drift: it has the poses with the most evidence. The path leads to another
    one, which takes less.
    """
    size, (a, b, guess, covariance) = place.submap.size, prior
    aligned = functools.partial(match_submaps, nodes, a, b, config=config, size=size)

    def hypothesis(pose: Array) -> Hypothesis:
        return Hypothesis(place.agreement_with(around(b), pose), prior.log(pose))

    pose, match = found.pose, aligned(found.pose)
    best, others = hypothesis(match.pose), list[Hypothesis]()
    if found.second_best > 0.0:
        others.append(hypothesis(found.second_best_pose))
    if not are_one(guess, pose, APART):
        led = aligned(guess, prior=np.asarray(np.linalg.inv(covariance))).pose
        if not are_one(led, match.pose, APART):
            there = hypothesis(led)
            others.append(there)
            if there.agreement.evidence >= needed and there.beyond(best, size) > 0.0:
                pose, match, best, others[-1] = led, aligned(led), there, best
    return pose, match, best, [one for one in others if one.agreement.evidence >= needed]


def _verdict(source: ScanMatch, pose: Array, match: Match, needed: float, margin: float) -> Verdict:
    slipped = between_planar(pose, match.pose)
    metres, radians = float(np.hypot(*slipped[:2])), abs(float(slipped[2]))
    numbers = {"evidence": source.evidence, "limit": needed}
    if source.evidence < needed:
        return Verdict(Judge.LASER, False, Why.LITTLE_EVIDENCE, numbers)
    if source.beyond < margin:
        numbers = {
            "second_best": source.second_best,
            "evidence": source.evidence,
            "beyond": source.beyond,
        }
        return Verdict(Judge.LASER, False, Why.AMBIGUOUS_POSE, numbers)
    if metres > APART[0] or radians > APART[1]:
        numbers = {"metres": metres, "degrees": float(np.degrees(radians))}
        return Verdict(Judge.LASER, False, Why.NOT_CONVERGED, numbers)
    if is_degenerate(match.information):
        return Verdict(Judge.LASER, False, Why.DEGENERATE)
    numbers |= {"overlap": source.overlap, "residual": source.residual}
    return Verdict(Judge.LASER, True, Why.SCANS_ALIGNED, numbers)


def _constraint(
    nodes: LaserNodes, a: int, b: int, pose: Array, information: Array, source: ScanMatch,
    verdict: Verdict,
) -> Judged:  # fmt: skip
    return Judged(
        from_id=int(nodes.ids[a]),
        to_id=int(nodes.ids[b]),
        kind=ConstraintKind.LOOP_CLOSURE,
        i_from_j=planar_to_matrix(pose),
        information=information_from_planar(information),
        source=source,
        verdicts=(verdict,),
    )


def closure_information(match: Match) -> Array:
    """(3, 3): nothing is known better than the maps of the two places agree in themselves."""
    known = match.information + FAINT * np.eye(3)
    return np.asarray(np.linalg.inv(np.linalg.inv(known) + _AGREEMENT))
