"""A laser in a known map: lost, found by search over the whole map, tracked, and lost again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import (
    between_planar,
    compose_planar,
    covariance_from_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.geometry.rigid import between
from mapmyworld.kernels.planar_algebra import invert3
from mapmyworld.localisation.global_localisation import Discovery, GlobalLocalisation
from mapmyworld.localisation.known_place import KnownPlace
from mapmyworld.localisation.observation import (
    SEARCHED,
    Moment,
    fit_at,
    is_motion_lost,
    is_shaken,
    match_at,
    scan_of,
)
from mapmyworld.odometry.laser_odometry import LaserMotion, LaserTracker
from mapmyworld.odometry.unobserved_motion import ANYWHERE
from mapmyworld.registration.scan_matching import FINE, Match
from mapmyworld.registration.scan_search import APART
from mapmyworld.registration.submaps import MARGIN
from mapmyworld.types import Frame
from mapmyworld.types.localisation import Estimate, State

if TYPE_CHECKING:
    from mapmyworld.localisation.known_images import KnownImages

_REMEMBERED = 3000  # moments while lost that a recognition explains afterwards


class LaserLocaliser:
    """Follows a robot through a known place; holds little but the place itself."""

    def __init__(
        self, place: KnownPlace, config: Config, images: KnownImages | None = None
    ) -> None:
        """`images` of the same map help where scans alone are ambiguous."""
        self._place, self._images, self._config = place, images, config
        self._submap = config.places.laser_submap
        self._tracker = LaserTracker(config)
        self._global = GlobalLocalisation(place, config)
        self._pose, self._covariance = np.zeros(3), np.diag(ANYWHERE)
        self._tracked: Array | None = None
        self._state = State.LOST
        self._waiting: deque[Moment] = deque(maxlen=_REMEMBERED)
        self._confirmed_at = self._agreed_at = 0.0  # m of path
        self._is_confirmed = False
        self.estimates: list[Estimate] = []
        self.notes: list[str] = []

    def follow(self, frames: Iterable[Frame]) -> list[Estimate]:
        """An estimate for every frame."""
        for frame in frames:
            moved = self._tracker.track(frame)
            moment = self._moment(frame, moved)
            self._global.follow(moment)
            self._pose, self._covariance = moment.moved(self._pose, self._covariance)
            if self._state == State.LOST:
                self._state, fit = self._seek(moment, frame)
            else:
                self._state, fit = self._keep(moment)
            self._report(frame, fit)
            if self._state != State.LOST:
                self._explain_past(moment)
        self.notes += self._tracker.notes()
        return self.estimates

    def _moment(self, frame: Frame, moved: LaserMotion) -> Moment:
        step = np.zeros(3) if self._tracked is None else between_planar(self._tracked, moved.pose)
        self._tracked = moved.pose
        scan = scan_of(frame, self._config)
        motion_lost = is_motion_lost(moved, step, self._recorded_step(frame))
        return Moment(
            len(self.estimates), scan, moved.pose, step, moved.covariance, is_shaken(moved),
            motion_lost,
        )  # fmt: skip

    def _recorded_step(self, frame: Frame) -> Array | None:
        """Motion (3,) since the frame before, as recorded."""
        before = self.estimates[-1].odom_from_base if self.estimates else None
        if before is None or frame.odom_from_base is None:
            return None
        return matrix_to_planar(between(before, frame.odom_from_base))

    # While the place is known

    def _keep(self, moment: Moment) -> tuple[State, float]:
        if moment.is_blind:
            return self._reckon(moment), 0.0
        match = match_at(
            self._place, moment, self._pose, FINE, self._config, invert3(self._covariance)
        )
        fit = fit_at(self._place, moment, match.pose)
        if fit.evidence < MARGIN:
            doubted = fit.evidence <= -MARGIN or not self._is_confirmed
            return (self._lose(moment) if doubted else self._reckon(moment)), fit.agreeing
        self._agreed_at = self._global.path
        self._correct(match, moment)
        if not moment.shaken and self._global.path - self._confirmed_at < self._submap:
            return State.TRACKING, fit.agreeing
        self._confirmed_at = self._global.path
        return self._confirm(moment), fit.agreeing

    def _reckon(self, moment: Moment) -> State:
        """Goes on by odometry where the map does not help, if that is certain enough."""
        sigma = np.sqrt(np.linalg.eigvalsh(self._covariance[:2, :2])[-1])
        far = self._global.path - self._agreed_at > self._submap
        if moment.shaken or far or 2.0 * sigma > APART[0]:
            return self._lose(moment)
        return State.TRACKING

    def _correct(self, match: Match, moment: Moment) -> None:
        """Takes over a match whose prior was the prediction."""
        information = match.information + invert3(self._covariance)
        self._pose = match.pose
        self._covariance = invert3(information) + self._place.uncertainty(moment.points)

    def _confirm(self, moment: Moment) -> State:
        """Whether what was seen in the last metres could lie elsewhere, and rather so."""
        elsewhere = self._global.is_elsewhere(moment, self._pose)
        if elsewhere:
            return self._lose(moment)
        if elsewhere is None:
            return State.TRACKING
        self._is_confirmed = True
        return State.RECOGNISED

    def _lose(self, moment: Moment) -> State:
        self._global.begin(moment, self._pose if self._is_confirmed else None)
        self._waiting.clear()
        self._waiting.append(moment)
        return State.LOST

    # While it is not

    def _seek(self, moment: Moment, frame: Frame) -> tuple[State, float]:
        self._waiting.append(moment)
        found = self._global.look(moment) or self._by_image(moment, frame)
        if found is None:
            return State.LOST, 0.0
        self._take(found, moment)
        return State.RECOGNISED, found.fit.agreeing

    def _by_image(self, moment: Moment, frame: Frame) -> Discovery | None:
        if self._images is None or not frame.images or moment.is_blind:
            return None
        view = self._images.view_of(frame.images[0])
        reported = None if view is None else self._images.most_alike(view)
        if reported is None:
            return None
        return self._global.add_match(moment, matrix_to_planar(reported.map_from_base))

    def _take(self, found: Discovery, moment: Moment) -> None:
        self._covariance = SEARCHED
        self._correct(found.match, moment)
        self._is_confirmed = found.supported
        self._confirmed_at = self._agreed_at = self._global.path

    # What is said of it

    def _report(self, frame: Frame, fit: float) -> None:
        flat = self._config.registration.range_sigma**2
        covariance = covariance_from_planar(self._covariance, off_plane=flat)
        pose, known = planar_to_matrix(self._pose), self._state != State.LOST
        stamp, odometry = frame.stamp_ns, frame.odom_from_base
        self.estimates.append(Estimate(stamp, pose, covariance, self._state, fit, known, odometry))

    def _explain_past(self, now: Moment) -> None:
        """Backwards from a recognition, as long as the scans fit: where the robot had been."""
        pose, after = self._pose, now
        prior = invert3(SEARCHED)
        while self._waiting:
            moment = self._waiting.pop()
            if moment.index == now.index:
                continue
            if moment.shaken:
                break  # its scan may have been taken while the robot was carried
            guess = compose_planar(pose, between_planar(after.tracked, moment.tracked))
            match = match_at(self._place, moment, guess, FINE, self._config, prior)
            fit = fit_at(self._place, moment, match.pose)
            if fit.evidence < MARGIN:
                break
            pose, after = match.pose, moment
            self.estimates[moment.index] = replace(
                self.estimates[moment.index],
                map_from_base=planar_to_matrix(pose),
                covariance=self.estimates[now.index].covariance,
                fit=fit.agreeing,
                known=True,
            )
        self._waiting.clear()
