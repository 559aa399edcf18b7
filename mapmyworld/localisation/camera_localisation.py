"""A camera in a known map: recognised by words and geometry, followed by odometry in between."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import covariance_from_planar
from mapmyworld.geometry.rigid import between, invert, se3_adjoint, se3_exp, se3_log
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.localisation.known_images import KnownImages, Sighting
from mapmyworld.odometry.unobserved_motion import ANYWHERE
from mapmyworld.registration.scan_search import APART
from mapmyworld.registration.views import View
from mapmyworld.sensing import Plan
from mapmyworld.stages.nodes import Motion
from mapmyworld.stages.trackers import make_tracker
from mapmyworld.types import Frame
from mapmyworld.types.localisation import Estimate, State

_MISSES = 4  # images in a row that ought to be recognised and are not, before the place is lost
_DRIFT = np.array([0.02, 0.02, 0.02, 0.03, 0.03, 0.03])  # rad and m a metre, beside the tracker's
_UNKNOWN = covariance_from_planar(np.diag(ANYWHERE), off_plane=1.0)  # rad^2 and m^2


class CameraLocaliser:
    """Follows a robot by its camera through a map that keeps images."""

    def __init__(self, images: KnownImages, plan: Plan, config: Config) -> None:
        self._images, self._config = images, config
        self._tracker = make_tracker(plan, config)
        self._pose, self._covariance = np.eye(4), _UNKNOWN
        self._tracked: Array | None = None
        self._looked_at: Array | None = None
        self._state = State.LOST
        self._misses, self._is_found = 0, False
        self.estimates: list[Estimate] = []
        self.notes: list[str] = []

    def follow(self, frames: Iterable[Frame]) -> list[Estimate]:
        """An estimate for every frame that the odometry can place."""
        for frame, motion in self._tracker.follow(frames):
            self._predict(motion)
            fit = self._look(frame, motion)
            known = self._state != State.LOST
            self.estimates.append(
                Estimate(
                    frame.stamp_ns, self._pose, self._covariance, self._state, fit, known,
                    frame.odom_from_base,
                )
            )  # fmt: skip
            if self._state == State.RECOGNISED:
                self._state = State.TRACKING
        self.notes += self._tracker.notes()
        return self.estimates

    def _predict(self, motion: Motion) -> None:
        pose = motion.tracked_from_base
        step = np.eye(4) if self._tracked is None else between(self._tracked, pose)
        self._tracked = pose
        self._pose = self._pose @ step
        adjoint = se3_adjoint(invert(step))
        distance = float(np.linalg.norm(step[:3, 3])) + 0.2 * float(rotation_angle(step))
        drift = np.diag((_DRIFT * distance) ** 2) + np.diag(_DRIFT**2) * distance * 0.1
        self._covariance = adjoint @ self._covariance @ adjoint.T + motion.covariance + drift

    def _look(self, frame: Frame, motion: Motion) -> float:
        """Compares the frame's image, if the robot moved since the last one; the share agreed."""
        if not frame.images or not self._is_due(motion.tracked_from_base):
            self._give_up_if_blind()
            return 0.0
        view = self._images.view_of(frame.images[0])
        self._looked_at = motion.tracked_from_base
        sighting = None if view is None else self._sight(view)
        if sighting is None:
            self._give_up_if_blind()
            return 0.0
        return sighting.registration.overlap

    def _is_due(self, tracked: Array) -> bool:
        if self._looked_at is None:
            return True
        moved = between(self._looked_at, tracked)
        settings = self._config.odometry
        far = float(np.linalg.norm(moved[:3, 3])) >= settings.keyframe_distance
        return far or float(rotation_angle(moved)) >= settings.keyframe_angle

    def _sight(self, view: View) -> Sighting | None:
        if self._state == State.LOST:
            return self._seek(view)
        near = self._images.near(self._pose)
        found = [self._images.sight(view, node, self._pose) for node in near]
        seen = [s for s in found if s is not None and self._is_plausible(s)]
        if seen:
            self._misses = 0
            for sighting in seen:
                self._correct(sighting)
            self._state = State.RECOGNISED
            return seen[0]
        self._misses += len(near) > 0
        if self._misses >= _MISSES:
            self._lose()
        return None

    def _is_plausible(self, sighting: Sighting) -> bool:
        """Whether a sighting agrees with where the robot is thought to be, in sigmas."""
        error = se3_log(between(self._pose, sighting.map_from_base))
        noise = np.linalg.inv(sighting.registration.information)
        return bool(error @ np.linalg.solve(self._covariance + noise, error) < 30.0)

    def _seek(self, view: View) -> Sighting | None:
        """The place that looks alike, once it was found twice where the motion leads."""
        best = self._images.most_alike(view)
        if best is None:
            return None
        agrees, self._is_found = self._is_found and self._is_plausible(best), True
        self._pose = best.map_from_base
        self._covariance = np.asarray(np.linalg.inv(best.registration.information))
        if not agrees:
            return None
        self._state, self._misses = State.RECOGNISED, 0
        return best

    def _correct(self, sighting: Sighting) -> None:
        """One step of an extended Kalman filter on SE(3), the error in the robot's frame."""
        error = se3_log(between(self._pose, sighting.map_from_base))
        noise = np.linalg.inv(sighting.registration.information)
        gain = self._covariance @ np.linalg.inv(self._covariance + noise)
        self._pose = self._pose @ se3_exp(gain @ error)
        kept = np.eye(6) - gain
        self._covariance = kept @ self._covariance @ kept.T + gain @ noise @ gain.T

    def _give_up_if_blind(self) -> None:
        sigma = np.sqrt(np.linalg.eigvalsh(self._covariance[3:5, 3:5])[-1])
        if self._state != State.LOST and 2.0 * sigma > APART[0]:
            self._lose()

    def _lose(self) -> None:
        self._state, self._misses, self._is_found = State.LOST, 0, False
