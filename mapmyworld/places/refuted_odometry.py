"""Odometry that led on where scans fitted nothing, and that what is seen afterwards refutes.

A robot that is carried off, or whose wheels slip while its laser is covered, goes on elsewhere than
its odometry indicates. That nothing fits does not show it: glass and passers-by do that too. What
shows it is that the place afterwards lies in what was seen before, but at another pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    information_to_planar,
    invert_planar,
    planar_adjoint,
    planar_to_matrix,
)
from mapmyworld.odometry.pose_hypotheses import FAULT, FAULT_SIZE
from mapmyworld.parallel import in_threads
from mapmyworld.places.doubted_odometry import in_doubt, measured_anew
from mapmyworld.places.laser_closures import closure_information
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.places.laser_submaps import match_members, submap_of
from mapmyworld.places.whole_map import SETTLED, WholeMap, map_of_scans
from mapmyworld.registration.place_evidence import (
    FORTH,
    Hypothesis,
    Place,
    needed_evidence,
)
from mapmyworld.registration.scan_matching import Match
from mapmyworld.registration.scan_search import APART, are_one, search_about
from mapmyworld.registration.submaps import MARGIN, NATS
from mapmyworld.types import (
    RELOCALISED,
    ConstraintKind,
    Judge,
    Judged,
    LaserTracking,
    Verdict,
    Why,
)

FAULT_ODDS = -float(np.log(FAULT))
"""Nats against a fault."""
_WINDOW = 3.0, 2.0  # m and rad to each side in which it is looked for


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Motions by odometry alone, between which the robot saw nothing that fitted."""

    motions: list[Judged]
    first: int
    """Row of the node before."""
    last: int
    """Row of the node after."""


def refuted_odometry(
    nodes: LaserNodes, constraints: Sequence[Judged], config: Config
) -> list[Judged]:
    """The constraints; a refuted motion gives way to one by scans, or to a tracking loss.

    One that is in doubt keeps its measure, and is as uncertain as a fault is large. So is one that
    nothing seen afterwards confirms or refutes, where a fault is likelier than none: by the share
    of faults among the others and one that is right.
    """
    sections = list(_sections(nodes, constraints, config.places.laser_spacing))
    poses, start, anew, undecided = nodes.poses, 0, list[Judged](), list[Judged]()
    refuted: dict[int, Verdict] = {}
    ends = [*(section.first for section in sections[1:]), len(nodes.ids) - 1]
    for section, end in zip(sections, ends, strict=False):
        found = _refutation(replace(nodes, poses=poses), section, start, end, config)
        first = section.motions[0]
        if found is None:
            undecided.append(first)
            continue
        verdict, match = found
        if verdict is None:
            continue
        refuted[first.to_id] = verdict
        if verdict.why is Why.DOUBTED:
            anew.append(in_doubt(first, True))
        elif match is None:
            start = section.last
            lost = LaserTracking("lost", 0.0, lost=True)
            anew.append(measured_anew(first, first.i_from_j, np.diag(np.square(FAULT_SIZE)), lost))
        else:
            begins = int(nodes.ids.searchsorted(first.to_id))
            anew.append(
                _relocalised(first, match, between_planar(poses[begins], poses[section.last]))
            )
            poses = _moved_to(poses, section, begins, match)
    faults = sum(verdict.why is Why.REFUTED for verdict in refuted.values())
    decided = faults + len(sections) - len(refuted) - len(undecided)
    if 2 * faults > decided + 1:
        shown = {"faults": float(faults), "sections": float(decided)}
        refuted |= {c.to_id: Verdict(Judge.LASER, False, Why.FAULTS, shown) for c in undecided}
        anew += [in_doubt(c, True) for c in undecided]
    judged = [
        c.judged(refuted[c.to_id]) if _is_motion(c) and c.to_id in refuted else c
        for c in constraints
    ]
    return [*judged, *sorted(anew, key=lambda c: c.to_id)]


def _moved_to(poses: Array, section: Section, begins: int, match: Match) -> Array:
    """(N, 3) poses (N, 3), those from row `begins` on moved so that the section ends at its match
    in the frame of the node before it.
    """
    there = compose_planar(poses[section.first], match.pose)
    rest = compose_planar(there, between_planar(poses[section.last], poses[begins:]))
    return np.concatenate([poses[:begins], rest])


def is_unsupported(c: Judged) -> bool:
    """Whether scans do not show the motion: they fitted nothing on the way, or there are none."""
    after_gap = isinstance(c.source, LaserTracking) and c.source.after_gap
    return _is_motion(c) and (c.is_unmatched or after_gap)


def _is_motion(c: Judged) -> bool:
    return c.kind is ConstraintKind.NEIGHBOUR


def _sections(
    nodes: LaserNodes, constraints: Sequence[Judged], spacing: float
) -> Iterator[Section]:
    """Those less than `spacing` metres of path apart, which show no more than one, are one."""
    row = {int(i): k for k, i in enumerate(nodes.ids)}
    section: Section | None = None
    for c in constraints:
        if not (is_unsupported(c) and {c.from_id, c.to_id} <= row.keys()):
            continue
        first, last = row[c.from_id], row[c.to_id]
        if section and nodes.path[first] - nodes.path[section.last] > spacing:
            yield section
            section = None
        before = section or Section([], first, last)
        section = Section([*before.motions, c], before.first, last)
    if section:
        yield section


def _refutation(
    nodes: LaserNodes, section: Section, start: int, end: int, config: Config
) -> tuple[Verdict | None, Match | None] | None:
    """What refutes a section's odometry, None where it is right; nodes from row `start` on and up
    to `end` are known.

    And the match of the node after in the one before's frame: None where two poses are as likely.
    Nothing at all where what is seen afterwards does not show it.
    """
    before, after = _around(nodes, section, start, end, config.places.laser_submap)
    if not len(before) or not len(after):
        return None
    a, b = section.first, section.last
    known, place = map_of_scans(submap_of(nodes, before, a)), Place.of(submap_of(nodes, after, b))
    odometry = between_planar(nodes.poses[a], nodes.poses[b])
    agreement = known.best_about(place, odometry, *_window(section))[1]
    there = _Candidate(agreement, 0.0, odometry)
    tried = _candidates(known, place, odometry, config.threads)
    no_fault = (None, None) if agreement.log_odds >= NATS * MARGIN else None
    if not tried:
        return no_fault
    best = tried[0]
    needed = max(agreement.known_odds, 0.0) + FAULT_ODDS + NATS * needed_evidence(*_WINDOW)
    if best.log_odds <= needed:
        likelier = [one for one in tried if one.beyond(there) >= MARGIN]
        return (likelier[0].verdict(Why.DOUBTED, odometry), None) if likelier else no_fault
    verdict = best.verdict(Why.REFUTED, odometry)
    others = [o for o in tried if not are_one(best.pose, o.pose, APART)]
    if any(best.beyond(o) < MARGIN for o in others):
        return verdict, None
    match = match_members(nodes, (a, before), (b, after), best.pose, config)
    return verdict, match if are_one(best.pose, match.pose, APART) else None


def _around(
    nodes: LaserNodes, section: Section, start: int, end: int, reach: float
) -> tuple[Index, Index]:
    """Nodes (K,) that see something right before a section, and those right after it."""
    rows = np.arange(start, end + 1)
    rows = rows[nodes.sees[rows]]
    since = nodes.path[section.first] - nodes.path[rows]
    until = nodes.path[rows] - nodes.path[section.last]
    before = rows[(rows <= section.first) & (since <= 2.0 * reach)]
    return before, rows[(rows >= section.last) & (until <= reach)]


def _window(section: Section) -> tuple[float, float]:
    """Metres and radians to each side that odometry's own uncertainty covers."""
    steps = information_to_planar(np.stack([c.information for c in section.motions]))
    sigmas = np.sqrt(np.linalg.inv(steps).sum(axis=0).diagonal())
    return SETTLED[0] + 3.0 * float(sigmas[:2].max()), SETTLED[1] + 3.0 * float(sigmas[2])


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate(Hypothesis):
    """The place after a section, seen from the node before it, where a fault leads there."""

    pose: Array
    """(3,) of the node after."""

    @property
    def log_odds(self) -> float:
        """Nats for this pose, and against a place never seen."""
        return self.agreement.log_odds + self.prior

    def verdict(self, why: Why, odometry: Array) -> Verdict:
        """Of odometry (3,) in favour of this pose."""
        apart = between_planar(odometry, self.pose)
        metres, degrees = float(np.hypot(*apart[:2])), float(np.degrees(abs(apart[2])))
        return Verdict(Judge.LASER, False, why, {"metres": metres, "degrees": degrees})


def _candidates(known: WholeMap, place: Place, odometry: Array, threads: int) -> list[_Candidate]:
    """Where the place may lie, about where odometry has it, the likeliest first.

    A search counts what agrees, and most of that lies where the place is wholly inside of what is
    known: one for each part of the window, so that what is known less of has its candidate as well.
    """
    window, points = np.array([_WINDOW[0], *_WINDOW]), place.submap.scored
    least, (distance, angle) = FORTH * needed_evidence(*_WINDOW), np.array(_WINDOW) / 3.0
    parts = product((-2.0 / 3.0, 0.0, 2.0 / 3.0), repeat=3)
    guesses = (odometry + window * offset for offset in parts)
    tried = list[_Candidate]()
    for pose in in_threads(
        lambda guess: search_about(points, known.grid, guess, distance, angle, least),
        guesses,
        threads,
    ):
        if pose is not None:
            apart = between_planar(odometry, pose) / FAULT_SIZE
            agreement = known.judge(place, pose)
            tried.append(_Candidate(agreement, -0.5 * float(apart @ apart), pose))
    return sorted(tried, key=lambda one: -one.log_odds)


def _relocalised(c: Judged, match: Match, onward: Array) -> Judged:
    """The motion that brings the node after a section, `onward` (3,) from this one's end, there."""
    carry = planar_adjoint(onward)
    covariance = carry @ np.linalg.inv(closure_information(match)) @ carry.T
    motion = planar_to_matrix(compose_planar(match.pose, invert_planar(onward)))
    source = LaserTracking(RELOCALISED, float(match.overlap))
    return measured_anew(c, motion, covariance, source)
