"""Visual odometry: the motion of an RGB-D camera, frame by frame against a local map."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import between, invert, se3_log, transform_points
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.odometry.local_map import Keyframe, LocalMap
from mapmyworld.odometry.motion_filter import (
    MotionFilter,
    blind_variances,
    covariance_of_base,
    exceeds_nis,
    gyro_rotation,
    motion_information,
)
from mapmyworld.odometry.unobserved_motion import GOES_ON
from mapmyworld.parallel import in_threads
from mapmyworld.registration.camera_pose import Sightings, inliers, ransac_pose, refine_pose
from mapmyworld.registration.features import extract_features
from mapmyworld.registration.views import (
    SEARCH_RADIUS,
    View,
    make_view,
    match_around,
    match_views,
    pixel_sigmas,
)
from mapmyworld.types import Frame, RgbdImage

_KEYFRAME_SHARE = 0.7  # of the last keyframe's points; fewer seen make a new one


@dataclass(frozen=True, slots=True, eq=False)
class VisualMotion:
    """Where the camera's robot is after a frame, and how that is known."""

    tracker_from_base: Array
    """(4, 4), in the tracker's own frame: the base at the first frame."""
    information: Array
    """(6, 6), rotation first, of the motion since the previous frame."""
    verdict: str
    """"first", "tracked", "dead reckoning" or "restarted"."""
    notes: tuple[str, ...] = ()
    inliers: int = 0
    sigma_m: float = 0.0
    """m by which the image left the place open, along the worst axis; 0 where there was none."""


class VisualTracker:
    """Tracks one RGB-D camera through a log. State: the local map and the last motion."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._least = config.visual.closure_inliers
        self._map = LocalMap(config)
        self._reference: Keyframe | None = None
        self._reference_inliers = 0
        self._filter = MotionFilter()  # tracker_from_base
        self._stamp_ns = 0
        self._seen_ns = 0
        self._frames = 0

    def track(self, frame: Frame) -> VisualMotion:
        """The pose after this frame; a frame without an image is bridged by dead reckoning."""
        return self._tracked(frame, view_of_frame(frame, self._config))

    def track_all(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, VisualMotion]]:
        """Each frame with its motion; features are prepared on other threads, a few ahead."""
        cv2.setNumThreads(1)

        def prepare(frame: Frame) -> tuple[Frame, View | None]:
            return frame, view_of_frame(frame, self._config)

        for frame, view in in_threads(prepare, frames, self._config.threads):
            yield frame, self._tracked(frame, view)

    def _tracked(self, frame: Frame, view: View | None) -> VisualMotion:
        predicted, how = self._predict(frame)
        motion = self._follow(frame, view, predicted, how)
        self._stamp_ns = frame.stamp_ns
        self._frames += 1
        return motion

    def _follow(self, frame: Frame, view: View | None, predicted: Array, how: str) -> VisualMotion:
        if view is None or len(view) == 0:
            return self._blind(frame, predicted, how, "no image with features")
        base_from_camera = view.camera.base_from_camera
        can_start = np.count_nonzero(np.isfinite(view.seen[:, 2])) >= self._least  # with depth
        if self._reference is None and can_start:
            return self._start(frame, view, predicted, "first", ())
        found = self._locate(view, predicted @ base_from_camera)
        if found is None:
            blind_s = (frame.stamp_ns - self._seen_ns) * 1e-9
            if blind_s > GOES_ON and can_start:
                note = f"lost for {blind_s:.1f} s: a new local map begins by {how}"
                return self._start(frame, view, predicted, "restarted", (note,))
            return self._blind(frame, predicted, how, "too few known points in view")
        seen, information, point_of = found
        count = int(np.count_nonzero(point_of >= 0))
        measured = covariance_of_base(information, base_from_camera)
        jump = between(predicted, seen @ invert(base_from_camera))
        if self._is_impossible(frame, jump, measured):
            return self._blind(frame, predicted, how, "recognised at an impossible place")
        pose = self._filter.correct(seen @ invert(base_from_camera), measured)
        map_from_camera = pose @ base_from_camera
        if can_start and self._is_keyframe(map_from_camera, count):
            self._reference = self._map.add_keyframe(map_from_camera, view, point_of)
            self._reference_inliers = count
        self._seen_ns = frame.stamp_ns
        known = motion_information(measured, self._filter.step_covariance, self._filter.slip)
        sigma = float(np.sqrt(np.linalg.eigvalsh(measured[3:, 3:])[-1]))
        return VisualMotion(self._filter.pose, known, "tracked", (), count, sigma)

    def _is_impossible(self, frame: Frame, jump: Array, measured: Array) -> bool:
        """Whether even a blind camera would be expected nearer: some picture has a double."""
        blind = np.diag(self._blind_variances(frame))
        return exceeds_nis(se3_log(jump), blind + measured + self._filter.pose_covariance())

    def _start(
        self, frame: Frame, view: View, pose: Array, verdict: str, notes: tuple[str, ...]
    ) -> VisualMotion:
        self._map = LocalMap(self._config)
        empty = np.full(len(view), -1, np.int64)
        map_from_camera = pose @ view.camera.base_from_camera
        self._reference = self._map.add_keyframe(map_from_camera, view, empty)
        self._reference_inliers = int(np.count_nonzero(self._reference.point_of >= 0))
        self._seen_ns = frame.stamp_ns
        self._filter.restart()
        return VisualMotion(pose, np.diag(1.0 / self._blind_variances(frame)), verdict, notes)

    def _blind(self, frame: Frame, predicted: Array, how: str, why: str) -> VisualMotion:
        information = np.diag(1.0 / self._blind_variances(frame))
        self._filter.coast(self._seconds_to(frame))
        return VisualMotion(predicted, information, "dead reckoning", (f"{why}: by {how}",))

    def _blind_variances(self, frame: Frame) -> Array:
        """(6,) of the motion to this frame without its image."""
        return blind_variances(self._seconds_to(frame), has_gyro=bool(frame.imu))

    def _seconds_to(self, frame: Frame) -> float:
        """Since the frame before; 0 for the first one, and where stamps step back."""
        return max(frame.stamp_ns - self._stamp_ns, 0) * 1e-9 if self._frames else 0.0

    def _predict(self, frame: Frame) -> tuple[Array, str]:
        """tracker_from_base (4, 4) expected before looking, and what it is based on."""
        if self._frames == 0:
            return np.eye(4), "start"
        seconds = self._seconds_to(frame)
        if frame.imu:
            turn = gyro_rotation(frame, self._stamp_ns)
            return self._filter.predict(seconds, turn), "gyroscope"
        return self._filter.predict(seconds), "constant velocity"

    def _locate(self, view: View, predicted: Array) -> tuple[Array, Array, Index] | None:
        """map_from_camera, its information, and the point each feature is; None when lost."""
        ids = self._map.near(predicted)
        for radius in (SEARCH_RADIUS, 3.0 * SEARCH_RADIUS):
            sightings, _ = self._look(view, ids, predicted, radius)
            pose = self._agree(sightings)
            if pose is not None:
                break
        else:
            pose = self._relocate(view)
        if pose is None:
            return None
        return self._optimised(view, pose)

    def _optimised(self, view: View, pose: Array) -> tuple[Array, Array, Index] | None:
        """Looks again around a good pose, for more points, and refines on all that agree."""
        settings = self._config.visual
        ids = self._map.near(pose)
        information = np.eye(6)
        point_of = np.full(len(view), -1, np.int64)
        radius = settings.inlier_sigmas * float(pixel_sigmas(view.features).max())
        for _ in range(2):
            sightings, matched = self._look(view, ids, pose, radius)
            pose, information = refine_pose(pose, sightings)
            agreed = inliers(pose, sightings, settings.inlier_sigmas)
        if np.count_nonzero(agreed) < self._least:
            return None
        point_of[matched[0][agreed]] = matched[1][agreed]
        return pose, information, point_of

    def _look(
        self, view: View, ids: Index, pose: Array, radius: float
    ) -> tuple[Sightings, tuple[Index, Index]]:
        """Sightings of map points near where `pose` expects them; their features and points."""
        points = self._map.points[ids]
        local = transform_points(invert(pose), points)
        words = self._map.words[ids]
        matches = match_around(view, local, words, radius)
        known = np.flatnonzero(matches >= 0)
        chosen = matches[known]
        sightings = Sightings(points[known], view.seen[chosen], view.sigmas[chosen])
        return sightings, (chosen.astype(np.int64), ids[known])

    def _agree(self, sightings: Sightings) -> Array | None:
        """The pose on which enough of the sightings agree; None where fewer do."""
        if len(sightings) < self._least:
            return None
        pose, agreed = ransac_pose(sightings, self._config.visual.inlier_sigmas)
        return pose if agreed >= self._least else None

    def _relocate(self, view: View) -> Array | None:
        """A pose by comparing with whole keyframes, the last ones first; None if none fits."""
        for keyframe in self._map.keyframes[:-8:-1]:
            mine, theirs = match_views(view, keyframe.view)
            points = transform_points(
                keyframe.map_from_camera, keyframe.view.camera_points()[theirs]
            )
            known = np.isfinite(points[:, 2])
            sightings = Sightings(points, view.seen[mine], view.sigmas[mine]).chosen(known)
            pose = self._agree(sightings)
            if pose is not None:
                return pose
        return None

    def _is_keyframe(self, map_from_camera: Array, count: int) -> bool:
        assert self._reference is not None
        settings = self._config.odometry
        motion = between(self._reference.map_from_camera, map_from_camera)
        return (
            count < _KEYFRAME_SHARE * self._reference_inliers
            or float(np.linalg.norm(motion[:3, 3])) > settings.keyframe_distance
            or float(rotation_angle(motion)) > settings.keyframe_angle
        )


def view_of_frame(frame: Frame, config: Config) -> View | None:
    """The features of the frame's first image, one with depth if there is one; None without."""
    image = first_image(frame)
    if image is None:
        return None
    return make_view(extract_features(image, config), image.camera, config)


def first_image(frame: Frame) -> RgbdImage | None:
    """The frame's first image with colours, one with depth if there is any."""
    seen = [image for image in frame.images if image.colour is not None]
    return min(seen, key=lambda image: image.depth is None, default=None)
