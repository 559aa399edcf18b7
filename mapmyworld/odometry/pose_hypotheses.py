"""Where a scan contradicts the odometry: several poses, compared by what they explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mapmyworld.config import OdometryConfig
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import between_planar, compose_planar
from mapmyworld.kernels.laser_motion import FAINT, STEP_VARIANCE
from mapmyworld.odometry.laser_keyframes import Keyframes
from mapmyworld.registration.place_evidence import FORTH, Place, needed_evidence
from mapmyworld.registration.scan_matching import COARSE, FINE, Match, PreparedScan
from mapmyworld.registration.scan_search import APART, are_one, evidence_elsewhere, search_about
from mapmyworld.registration.submaps import NATS

FEWEST = 12
"""Points of a scan below which it is not matched."""
FAULT = 1e-3
"""Probability of an odometry fault in a step, before there are any: it stalls, slips, catches up.
Without odometry, that the robot does not go on as it did."""
SEEN = 0.5
"""Share of the points seen through surfaces from which nobody can have been there."""
FAULT_SIZE: Array = np.array([2.0, 2.0, 1.0])
"""m, m and rad, sigmas of a fault that goes unobserved: slips, a robot lifted."""
_HALF_TRACK = 0.2  # m that a robot is off by a rad where one of its wheels slips
_LOG_ODDS = 2.5  # nats by which a point on a surface, and not beside, speaks for a pose: of
# such points a right one has 0.75 and a wrong one 0.2, log(0.75 / 0.2) + log(0.8 / 0.25)
_WEAK_PRIOR = np.diag([0.04, 0.04, 0.04])  # 5 m and 5 rad: keeps a corridor solvable


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What odometry indicates of a pose: a mixture of a normal distribution and two faults.

    Where a wheel slips, odometry indicates no heading. Where it stalls or catches up it indicates
    nothing, and the robot may be anywhere in the window of a search; one is as likely as the other.
    Without odometry the robot goes on as it did, or moves otherwise.
    """

    pose: Array
    """(3,) predicted."""
    variances: Array
    """(3,) m^2, m^2, rad^2."""
    has_odometry: bool
    """Whether the pose comes from odometry; else the robot is expected to go on as it did."""
    otherwise: Array
    """(3,) variances of a robot that moves otherwise; with odometry the same."""
    fault: float = FAULT
    """Probability of a fault in this step."""
    fits: float = 0.0
    """Log odds, before it is looked at, that a scan fits where the odometry leads."""

    def window(self, config: OdometryConfig) -> tuple[float, float]:
        """Metres and radians to each side in which a fault is looked for, or where the robot is."""
        fault = config.search_distance, config.search_angle
        if self.has_odometry:
            return fault
        reach = 3.0 * np.sqrt(self.variances[[0, 2]])
        return max(fault[0], float(reach[0])), max(fault[1], min(float(reach[1]), np.pi))

    def log(self, pose: Array, config: OdometryConfig) -> float:
        """Log density of a pose (3,) over that of the predicted one."""
        return float(np.logaddexp.reduce([log for log, _ in self._components(pose, config)]))

    def is_fault(self, pose: Array, config: OdometryConfig) -> bool:
        """Whether a fault, or a robot that moves otherwise, leads to a pose (3,) more likely."""
        return self._likeliest(pose, config)[0] > 0

    def _likeliest(self, pose: Array, config: OdometryConfig) -> tuple[int, Array]:
        """Number and variances (3,) of the component that is the densest at a pose (3,)."""
        components = self._components(pose, config)
        likeliest = int(np.argmax([log for log, _ in components]))
        return likeliest, components[likeliest][1]

    def _components(self, pose: Array, config: OdometryConfig) -> list[tuple[float, Array]]:
        """Log density at a pose (3,) and variances (3,) of each: as predicted, then otherwise."""
        apart = between_planar(self.pose, pose)
        expected = -0.5 * float((apart**2 / self.variances).sum()), self.variances
        if not self.has_odometry:
            share = self.fault * np.sqrt((self.variances / self.otherwise).prod())
            changed = np.log(share) - 0.5 * float((apart**2 / self.otherwise).sum())
            return [expected, (float(changed), self.otherwise)]
        distance, angle = self.window(config)
        heading = np.sqrt(2.0 * np.pi * self.variances[2]) / (2.0 * angle)
        known = self.variances[:2] + (_HALF_TRACK * apart[2]) ** 2
        slip = np.log(
            0.5 * self.fault * min(heading, 1.0) * np.sqrt((self.variances[:2] / known).prod())
        )
        slip -= 0.5 * float((apart[:2] ** 2 / known).sum())
        place = 2.0 * np.pi * np.sqrt(self.variances[:2].prod()) / (2.0 * distance) ** 2
        fault = float(np.log(0.5 * self.fault * min(heading * place, 1.0)))
        slipped = np.append(known, FAULT_SIZE[2] ** 2)
        return [expected, (float(slip), slipped), (fault, FAULT_SIZE**2)]

    def fused(self, match: Match, config: OdometryConfig) -> tuple[Match, Array, bool]:
        """A match that was made without the prior, with the likeliest component of it.

        And the variances (3,) of that one, and whether it is a fault.
        """
        likeliest, variances = self._likeliest(match.pose, config)
        prior = np.diag(1.0 / variances)
        known = match.information + prior + FAINT * np.eye(3)
        step = np.linalg.solve(known, prior @ between_planar(match.pose, self.pose))
        return replace(match, pose=compose_planar(match.pose, step)), variances, likeliest > 0


def likeliest_match(
    scan: PreparedScan, keyframes: Keyframes, state: Array, prior: Prior, first: Match,
    config: OdometryConfig, settings: Array,
) -> Match | None:  # fmt: skip
    """The likeliest of several matches, with the odometry and without it; None where none fits.

    `state` (8,) and `settings` (7,) are those of `track_scans`, `first` the match near the
    prediction.
    """
    place, view = keyframes.place(), Place.seen_by(scan)
    distance, angle = prior.window(config)
    reach = 3.0 * np.sqrt(prior.variances[[0, 2]])
    needed = needed_evidence(distance, angle)
    starts = [first.pose, compose_planar(state[:3], state[3:6]), state[:3].copy(), prior.pose]
    found = search_about(view.submap.scored, place.grid, starts[2], distance, angle, FORTH * needed)
    if found is not None:
        starts.append(found)
    plain, its_prior = place.agreement_with(view, first.pose), prior.log(first.pose, config)
    points = keyframes.independent_points(scan, settings)
    window = np.minimum(reach, (distance, angle))
    evidence = plain.evidence if _has_points(first, scan) else -np.inf
    beyond_chance = evidence - needed_evidence(*window)
    if not prior.has_odometry:  # nothing but a motion that is possible leads there
        beyond_chance += its_prior / NATS
    fits = beyond_chance >= 0.0
    best, most = (first, 0.0) if fits else (None, 0.0)
    is_refuted = (
        not fits
        and bool((reach <= (distance, angle)).all())  # else it may be where nothing is known
        and keyframes.share_seen_through(scan, prior.pose) >= SEEN
    )
    for match in _alternatives(scan, keyframes, starts, prior, first, config, settings):
        other = place.agreement_with(view, match.pose)
        if other.evidence < needed or not _has_points(match, scan):
            continue
        more = prior.log(match.pose, config)
        if not fits:  # against nothing that fits: what exceeds chance, or another place like this
            elsewhere = None if is_refuted else evidence_elsewhere(
                view.submap.scored, place.grid, match.pose, distance, angle, FORTH * needed
            )  # fmt: skip
            alike = 0.0 if elsewhere is None else place.agreement_with(view, elsewhere).evidence
            more += NATS * (other.evidence - max(needed, alike))
        elif are_one(first.pose, match.pose, APART):
            more += _LOG_ODDS * points * (_quality(match) - _quality(first)) - its_prior
        else:
            more += NATS * other.beyond(plain) - its_prior
        if more > most:
            best, most = match, more
    is_likely = beyond_chance + prior.fits / NATS >= 0.0
    return first if best is None and is_likely else best


def _alternatives(
    scan: PreparedScan, keyframes: Keyframes, starts: Sequence[Array], prior: Prior, first: Match,
    config: OdometryConfig, settings: Array,
) -> list[Match]:  # fmt: skip
    """Matches without the odometry; and with it alone along walls, where the `first` one makes it
    a fault, and this does not.
    """
    matches = keyframes.matches(scan, starts, _WEAK_PRIOR, COARSE, settings)
    if prior.is_fault(first.pose, config):
        held = _held(scan, keyframes, prior, first, settings)
        if not prior.is_fault(held.pose, config):
            matches.append(held)
    return matches


def _held(
    scan: PreparedScan, keyframes: Keyframes, prior: Prior, first: Match, settings: Array
) -> Match:
    """A match that shows nothing in the direction of the plane that the `first` one shows least.

    Along walls a few points that err together, as on jambs between two beams, look like many.
    """
    spread = np.linalg.inv(first.information + FAINT * np.eye(3))[:2, :2]
    along = np.append(np.linalg.eigh(spread)[1][:, 1], 0.0)
    known = _WEAK_PRIOR + np.outer(along, along) / STEP_VARIANCE
    match = keyframes.match(scan, prior.pose, known, FINE, settings)
    lost = match.information @ along
    share = np.outer(lost, lost) / max(float(along @ lost), FAINT)
    return replace(match, information=match.information - share)


def _has_points(match: Match, scan: PreparedScan) -> bool:
    return bool(match.overlap * len(scan.rows) >= FEWEST)


def _quality(match: Match) -> float:
    """Overlap, less what the points miss their lines by (0.1 m costs a whole overlap)."""
    return match.overlap - 10.0 * match.residual
