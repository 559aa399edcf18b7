"""One moment of a laser, and what a known place reports about it at a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    invert_planar,
    planar_adjoint,
)
from mapmyworld.localisation.known_place import KnownPlace
from mapmyworld.odometry.laser_odometry import LaserMotion
from mapmyworld.odometry.pose_hypotheses import FEWEST
from mapmyworld.registration.place_evidence import Agreement, Place
from mapmyworld.registration.scan_matching import Match, PreparedScan, match_scan, prepare_scan
from mapmyworld.registration.scan_search import APART
from mapmyworld.types import Frame

SEARCHED = np.diag([0.1, 0.1, 0.05]) ** 2
"""m^2, m^2, rad^2 of a pose that a search of the map, or a motion, leads to."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One frame of the log that is localised."""

    index: int
    """Of the frame in the log."""
    scan: PreparedScan
    tracked: Array
    """(3,) the tracker's pose."""
    step: Array
    """(3,) motion since the moment before."""
    covariance: Array
    """(3, 3) of that motion, in this moment's base."""
    shaken: bool
    """Whether that motion is doubtful: the scan did not go with the ones before."""
    motion_lost: bool
    """Whether it indicates nothing: odometry, if there is any, does not bear it out."""

    @property
    def points(self) -> Array:
        """(N, 2) of the scan, base frame."""
        return self.scan.rows[:, :2].astype(np.float64)

    @property
    def is_blind(self) -> bool:
        """Whether the scan shows too little to indicate anything."""
        return len(self.scan.rows) < FEWEST

    def moved(self, pose: Array, covariance: Array) -> tuple[Array, Array]:
        """A `pose` (3,) and its `covariance` (3, 3) after the motion: (3,) and (3, 3) as well."""
        back = planar_adjoint(invert_planar(self.step))
        return compose_planar(pose, self.step), back @ covariance @ back.T + self.covariance


def is_shaken(moved: LaserMotion) -> bool:
    """Whether a scan was not simply matched with the ones before."""
    return moved.verdict in ("lost", "odometry only", "odometry ignored")


def is_motion_lost(moved: LaserMotion, step: Array, recorded: Array | None) -> bool:
    """Whether a motion `step` (3,) of the tracker indicates nothing about how the robot moved.

    A scan that was placed without the odometry counts where the `recorded` motion (3,) agrees.
    """
    if moved.verdict != "odometry ignored":
        return is_shaken(moved)
    if recorded is None:
        return True
    off = np.abs(between_planar(recorded, step))
    return bool(np.hypot(off[0], off[1]) > APART[0] or off[2] > APART[1])


def scan_of(frame: Frame, config: Config) -> PreparedScan:
    """The frame's scan made ready; empty where it has none."""
    if frame.scan is None:
        return PreparedScan(np.zeros((0, 6), np.float32), np.zeros(2))
    return prepare_scan(frame.scan, config.registration)


def match_at(
    place: KnownPlace,
    moment: Moment,
    guess: Array,
    max_distances: Array,
    config: Config,
    prior_information: Array,
) -> Match:
    """The scan aligned with the place's scans around `guess` (3,), map_from_base.

    The guess, with its `prior_information` (3, 3), pulls as well. `max_distances` (R,), metres, are
    those from the targets' lines, one a step.
    """
    which = place.targets(guess, config.localisation)
    return match_scan(
        moment.scan, place.scans.some(which), place.poses[which], guess, config.registration,
        prior_information=prior_information, max_distances=max_distances,
    )  # fmt: skip


def fit_at(place: KnownPlace, moment: Moment, pose: Array) -> Agreement:
    """How the scan goes with the place if it was taken at `pose` (3,), map_from_base."""
    return place.whole.judge(Place.seen_by(moment.scan), pose)
