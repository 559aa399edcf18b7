"""How one session lies in another: an inter-session loop closure, of one log or of several.

Nothing is known of where a session began. So a place of it is looked for in all that the other one
mapped, and the relative pose that this gives is judged by every place of the session: what is seen
of each in the other's map speaks for that pose or against it. Poses that explain as much, as in a
hall after half a turn, leave the sessions apart. So do places that agree less than a session does
with itself: another building of the same style may share a corner or two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from mapmyworld.decisions import decided
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
)
from mapmyworld.places.node_drift import NodeDrift
from mapmyworld.places.session_places import SessionPlaces, some_changed
from mapmyworld.registration.place_evidence import Agreement
from mapmyworld.registration.scan_search import ANOTHER, are_one
from mapmyworld.registration.submaps import MARGIN, NATS

_CHECKED = 3  # places, those of the most evidence, that are looked for elsewhere
_OVERLAP = 0.5  # weight of a place: what it shows, the ones beside it show as well


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A relative pose, and what the places of the later session report about it."""

    move: Array
    """(3,) the later session's frame in that of the earlier one."""
    later: dict[int, Agreement]
    """Node -> what the place there and the earlier session's map report of each other."""
    earlier: dict[int, Agreement]
    """The same of the earlier session's places in the later one's map."""
    poses: dict[int, Array]
    """Node -> the pose (3,) in the earlier session's map at which its place in the later one fits
    best, within what both drifted.
    """
    prior: float = 0.0
    """Log density, in nats, of what leads there, less that where it is largest."""

    @property
    def log_odds(self) -> float:
        """Nats for this pose, and against another place like those seen.

        Both sessions report of what they share, so that each counts half.
        """
        seen = _log_odds(self.later.values()) + _log_odds(self.earlier.values())
        return 0.5 * seen + self.prior

    def is_same(self, other: Hypothesis) -> bool:
        """Whether places that speak for both relative poses lie at one pose, whichever is taken."""
        speak = [k for k in self.later if min(self.later[k].log_odds, other.later[k].log_odds) > 0]
        return bool(speak) and all(are_one(self.poses[k], other.poses[k], ANOTHER) for k in speak)

    def refutes(self, other: Hypothesis) -> float:
        """Points by which another pose is less likely: as all places contradict it more than this
        one, and as less leads there.
        """
        later = [one.refutes(other.later[k]) for k, one in self.later.items()]
        earlier = [one.refutes(other.earlier[k]) for k, one in self.earlier.items()]
        return 0.5 * (_together(later) + _together(earlier)) + (self.prior - other.prior) / NATS


def _together(places: Sequence[float]) -> float:
    """What places show together: each after the first shows half of it once more."""
    share = (1.0 + _OVERLAP * (len(places) - 1)) / max(len(places), 1)
    return share * sum(places)


def _log_odds(places: Iterable[Agreement]) -> float:
    """Of places beside each other, which show half of the same."""
    return some_changed(np.array([_OVERLAP * one.log_odds for one in places]))


@dataclass(frozen=True, slots=True, eq=False)
class LossPrior:
    """What the path across losses of tracking shows of how a later session lies to an earlier one.

    At the later one's first node after a loss, about which it may be turned by any angle: from
    there to a place each session adds what it drifted.
    """

    drift: NodeDrift
    earlier: SessionPlaces
    later: SessionPlaces

    @property
    def limit(self) -> float:
        """Sigmas from which a relative pose contradicts it."""
        return self.later.config.odometry.contradiction

    @property
    def begins(self) -> int:
        """Row of the later session's first node after a loss."""
        rows = self.later.rows
        return int(rows[rows > self.earlier.rows[0]][0])

    def window(self, at: Array) -> tuple[float, float]:
        """Metres and radians by which a place of the later session, at a pose (3,), may be off."""
        covariance = self._covariance(at, at)
        metres = self.limit * np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[1])
        angle = self.limit * np.sqrt(covariance[2, 2])
        apart = np.hypot(*(at - self.drift.poses[self.begins])[:2])
        return float(metres + 2.0 * apart * np.sin(min(angle, np.pi) / 2.0)), float(angle)

    def log(self, move: Array, at: Array) -> float:
        """Log density, in nats, of the later session's frame at `move` (3,) in the earlier one's,
        less that where it is largest, as a place at a pose (3,) of the later one's shows.
        """
        begins = self.drift.poses[self.begins]
        covariance = self._covariance(at, compose_planar(move, at))
        apart = between_planar(begins, compose_planar(move, begins))
        return -0.5 * float(apart @ np.linalg.solve(covariance, apart))

    def allows(self, move: Array, at: Array) -> bool:
        """Whether a frame at `move` (3,) is near enough, as a place at a pose (3,) shows."""
        return self.log(move, at) >= -0.5 * self.limit**2

    def _covariance(self, later: Array, earlier: Array) -> Array:
        """(3, 3) of where the later session begins, in its own frame, by a place that lies at a
        pose (3,) in each: what both drifted from there to the loss, and the loss.
        """
        ways = np.array([self.later.nearest(later), self.earlier.nearest(earlier)])
        found = self.drift.covariances(ways, np.full(2, self.begins))
        return np.asarray(found.sum(axis=0))


def locate_session(
    earlier: SessionPlaces, later: SessionPlaces, prior: LossPrior | None = None
) -> Array | None:
    """The later session's frame (3,) in that of the earlier one; None where that is open."""
    tried: list[Hypothesis] = []
    needed = earlier.whole.needed_odds(len(later.sought))
    for spot in later.sought:
        at = later.nodes.poses[spot]
        move = _move_by_place(earlier, later, spot, prior)
        if move is None or any(_is_same(move, other.move, at) for other in tried):
            continue
        tried.append(judge_pose(earlier, later, move, at, prior))
        odds = tried[-1].log_odds
        decided("join", f"session at {move.round(2)}: log odds {odds:.0f}, needed {needed:.0f}")
    best = max(tried, key=lambda one: one.log_odds, default=None)
    if best is None or best.log_odds < needed:
        return None
    same = 0.5 * (earlier.is_of(best.later.values()) + later.is_of(best.earlier.values()))
    if same < 0.0:
        decided("join", f"another building like it is likelier by {-same:.1f} nats")
        return None
    possible = needed - NATS * MARGIN
    for other in chain(tried, _elsewhere(earlier, later, best, prior)):
        if other.log_odds > possible and not best.is_same(other) and best.refutes(other) < MARGIN:
            decided("join", f"session as well at {other.move.round(2)}")
            return None
    return best.move


def _move_by_place(
    earlier: SessionPlaces, later: SessionPlaces, spot: int, prior: LossPrior | None
) -> Array | None:
    """The later frame (3,) in the earlier one at which the place around `spot` fits best, of the
    two best ones that which the loss allows.
    """
    place, at = later.places[spot], later.nodes.poses[spot]
    if prior is None:
        pose = earlier.whole.find(place)
        return None if pose is None else compose_planar(pose, invert_planar(at))
    pose = earlier.whole.find_about(place, at, *prior.window(at))
    for _ in range(2):
        if pose is None:
            return None
        move = compose_planar(pose, invert_planar(at))
        if prior.allows(move, at):
            return move
        pose = earlier.whole.find_other(place, pose)
    return None


def judge_pose(
    earlier: SessionPlaces, later: SessionPlaces, move: Array, about: Array,
    prior: LossPrior | None = None,
) -> Hypothesis:  # fmt: skip
    """Odds of the later frame (3,) in the earlier one, found from a place at `about` (3,) in it.

    Every place may be off by what the sessions drifted since the one that was found.
    """
    there, back = compose_planar(move, about), invert_planar(move)
    found = _reports(earlier, later, move, about)
    return Hypothesis(
        move,
        {k: agreement for k, (_, agreement) in found.items()},
        {k: agreement for k, (_, agreement) in _reports(later, earlier, back, there).items()},
        {k: pose for k, (pose, _) in found.items()},
        0.0 if prior is None else prior.log(move, about),
    )


def _reports(
    known: SessionPlaces, other: SessionPlaces, move: Array, about: Array
) -> dict[int, tuple[Array, Agreement]]:
    """Pose (3,) and report of each place of a session in a map, which agree at `about` (3,)."""
    reports, windows = {}, other.windows(about)
    for k, place in other.places.items():
        guess = compose_planar(move, other.nodes.poses[k])
        pose, _ = known.whole.best_about(place, guess, *windows[k])
        reports[k] = pose, known.whole.judge(place, pose)
    return reports


def _elsewhere(
    earlier: SessionPlaces, later: SessionPlaces, best: Hypothesis, prior: LossPrior | None
) -> Iterator[Hypothesis]:
    """Other relative poses, at which places of either session fit the other one as well."""
    for move, about in chain(
        _other_moves(earlier, later, best.move, best.later),
        (
            (invert_planar(back), compose_planar(back, there))
            for back, there in _other_moves(later, earlier, invert_planar(best.move), best.earlier)
        ),
    ):
        if prior is None or prior.allows(move, about):
            yield judge_pose(earlier, later, move, about, prior)


def _other_moves(
    known: SessionPlaces, other: SessionPlaces, move: Array, reports: dict[int, Agreement]
) -> Iterator[tuple[Array, Array]]:
    """Frames (3,) of a session in that of a known one, but for `move` (3,), and the poses (3,) of
    the places that fit there.
    """
    for k in sorted(reports, key=lambda k: -reports[k].log_odds)[:_CHECKED]:
        at = other.nodes.poses[k]
        pose = known.whole.find_other(other.places[k], compose_planar(move, at))
        if pose is not None:
            yield compose_planar(pose, invert_planar(at)), at


def _is_same(move: Array, other: Array, at: Array) -> bool:
    """Whether two relative poses bring a pose of the later session to the same place."""
    return are_one(compose_planar(move, at), compose_planar(other, at), ANOTHER)


def find_joints(
    count: int, locate: Callable[[int, int], Array | None]
) -> dict[tuple[int, int], Array]:
    """For each session one earlier session of every group that it belongs to.

    (Earlier, later) -> what `locate` gives: the later frame (4, 4), or (3,) in the plane, in the
    earlier one.
    """
    group = list(range(count))
    joints: dict[tuple[int, int], Array] = {}
    for later in range(1, count):
        for earlier in range(later):
            pose = None if group[earlier] == group[later] else locate(earlier, later)
            if pose is not None:
                joints[earlier, later] = pose
                old, new = group[later], group[earlier]
                group = [new if g == old else g for g in group]
    return joints
