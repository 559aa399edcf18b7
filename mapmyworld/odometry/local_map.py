"""The keyframes around the camera and the points they saw: what the visual tracker looks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.graph.bundle_adjustment import Bundle, RelativePoses, adjust_bundle
from mapmyworld.registration.camera_pose import Sightings, inliers
from mapmyworld.registration.views import View

Array = NDArray[np.float64]
_WINDOW = 8  # keyframes adjusted together
_NEAREST = 20  # keyframes whose points are looked for
_KEPT = 200  # keyframes that are remembered
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Expectation:
    """Where a camera was expected before its image was looked at."""

    pose: Array
    """(4, 4) of the camera, in the map or in the frame of another camera."""
    information: Array
    """(6, 6), rotation first."""


@dataclass(slots=True, eq=False)
class Keyframe:
    """A remembered view: where it was taken, and which map point each feature is (-1 = none)."""

    number: int
    map_from_camera: Array
    """(4, 4)."""
    view: View
    point_of: Indices
    """(N,) slots of points, one for each feature of the view."""
    motion: Expectation | None = None
    """What was expected, in the frame of the keyframe before."""


class LocalMap:
    """Points with their words, seen by keyframes. Slots of forgotten points are used again."""

    def __init__(self, config: Config) -> None:
        self._settings, self._odometry = config.visual, config.odometry
        self.keyframes: list[Keyframe] = []
        self.points = np.zeros((0, 3))
        self.words = np.zeros((0, 4), np.uint64)
        self._sightings = np.zeros(0, np.int64)  # by keyframes; 0 = slot free
        self._made = 0

    def near(self, map_from_camera: Array) -> Indices:
        """(K,) ascending indices of the points that keyframes close to this pose (4, 4) saw."""
        if not self.keyframes:
            return np.zeros(0, np.int64)
        poses = np.stack([keyframe.map_from_camera for keyframe in self.keyframes])
        motion = between(map_from_camera, poses)
        unlike = np.linalg.norm(motion[:, :3, 3], axis=1) / self._odometry.keyframe_distance
        unlike += rotation_angle(motion) / self._odometry.keyframe_angle
        nearest = np.argsort(unlike, kind="stable")[:_NEAREST]
        seen = np.zeros(len(self.points) + 1, np.bool_)  # the last one for features without point
        for k in nearest:
            seen[self.keyframes[k].point_of] = True
        return np.flatnonzero(seen[:-1])

    def add_keyframe(
        self,
        map_from_camera: Array,
        view: View,
        point_of: Indices,
        expected: Expectation | None = None,
    ) -> Keyframe:
        """A new keyframe with the points its features were matched to; others with depth are new.

        The window around it is adjusted, and sightings that then disagree are forgotten. Where the
        camera was `expected` holds it in directions that images leave open. `map_from_camera` is
        (4, 4); `point_of` (N,) gives the point of each feature, -1 for none.
        """
        keyframe = Keyframe(self._made, map_from_camera.copy(), view, point_of.copy())
        if expected is not None and self.keyframes:
            before = between(self.keyframes[-1].map_from_camera, expected.pose)
            keyframe.motion = Expectation(before, expected.information)
        self._made += 1
        matched = np.flatnonzero(point_of >= 0)
        np.add.at(self._sightings, point_of[matched], 1)
        self.words[point_of[matched]] = view.words[matched]
        fresh = np.flatnonzero((point_of < 0) & np.isfinite(view.seen[:, 2]))
        slots = self._free_slots(len(fresh))
        self.points[slots] = transform_points(map_from_camera, view.camera_points()[fresh])
        self.words[slots] = view.words[fresh]
        self._sightings[slots] = 1
        keyframe.point_of[fresh] = slots
        self.keyframes.append(keyframe)
        if len(self.keyframes) > 1:
            self._adjust(keyframe)
            self._forget_unconfirmed()
        if len(self.keyframes) > _KEPT:
            self._forget(self.keyframes.pop(0))
        return keyframe

    def _free_slots(self, count: int) -> Indices:
        free = np.flatnonzero(self._sightings == 0)[:count]
        missing = count - len(free)
        if missing > 0:
            room = max(missing, 4096)
            start = len(self.points)
            self.points = np.concatenate([self.points, np.zeros((room, 3))])
            self.words = np.concatenate([self.words, np.zeros((room, 4), np.uint64)])
            self._sightings = np.concatenate([self._sightings, np.zeros(room, np.int64)])
            free = np.concatenate([free, np.arange(start, start + missing)])
        return free

    def _forget(self, keyframe: Keyframe) -> None:
        ids = keyframe.point_of[keyframe.point_of >= 0]
        np.subtract.at(self._sightings, ids, 1)

    def _forget_unconfirmed(self) -> None:
        """Points of the keyframe before the last two that no other keyframe has seen since."""
        if len(self.keyframes) < 4:
            return
        old = self.keyframes[-4]
        known = np.flatnonzero(old.point_of >= 0)
        lonely = known[self._sightings[old.point_of[known]] == 1]
        self._sightings[old.point_of[lonely]] = 0
        old.point_of[lonely] = -1

    def _window(self, keyframe: Keyframe) -> tuple[list[Keyframe], list[Keyframe]]:
        """Keyframes to adjust, which have most points in common, and all others that see these."""
        seen = np.zeros(len(self.points), np.bool_)
        seen[keyframe.point_of[keyframe.point_of >= 0]] = True
        shared = [_count_seen(other, seen) for other in self.keyframes]
        shared[-1] = 1 << 30
        order = np.argsort(-np.array(shared), kind="stable")
        close = [int(k) for k in order[:_WINDOW] if shared[k] >= 15]
        moved = [self.keyframes[k] for k in sorted(close)]
        for other in moved:
            seen[other.point_of[other.point_of >= 0]] = True
        rest = [other for k, other in enumerate(self.keyframes) if k not in close]
        return moved, [other for other in rest if _count_seen(other, seen)]

    def _adjust(self, keyframe: Keyframe) -> None:
        moved, held = self._window(keyframe)
        if not held:
            moved, held = moved[1:], moved[:1]
        if not moved:
            return
        frames = [*moved, *held]
        bundle, ids, feature_of = self._bundle_of(frames, len(moved))
        if len(bundle.camera_of) == 0:
            return
        adjusted, _ = adjust_bundle(bundle)
        for frame, pose in zip(moved, adjusted.cameras, strict=False):
            frame.map_from_camera = pose
        self.points[ids] = adjusted.points
        self._drop_outliers(frames, adjusted, feature_of)

    def _bundle_of(self, frames: list[Keyframe], free: int) -> tuple[Bundle, Indices, Indices]:
        """The bundle of these keyframes, its points' ids, and the feature of each observation."""
        features = [np.flatnonzero(frame.point_of >= 0) for frame in frames]
        camera = np.repeat(np.arange(len(frames)), [len(f) for f in features])
        feature = np.concatenate(features)
        point = np.concatenate([f.point_of[k] for f, k in zip(frames, features, strict=True)])
        used = np.zeros(len(self.points), np.bool_)
        used[point[camera < free]] = True
        kept = used[point]
        camera, feature, point = camera[kept], feature[kept], point[kept]
        order = np.lexsort((camera, point))
        camera, feature, point = camera[order], feature[order], point[order]
        ids = np.flatnonzero(used)
        local = np.searchsorted(ids, point)
        seen = np.empty((len(point), 3))
        sigmas = np.empty((len(point), 3))
        for k, frame in enumerate(frames):
            mine = camera == k
            seen[mine] = frame.view.seen[feature[mine]]
            sigmas[mine] = frame.view.sigmas[feature[mine]]
        fixed = np.arange(len(frames)) >= free
        poses = np.stack([frame.map_from_camera for frame in frames])
        motions = _motions_between(frames)
        bundle = Bundle(poses, fixed, self.points[ids], camera, local, seen, sigmas, motions)
        return bundle, ids, feature

    def _drop_outliers(self, frames: list[Keyframe], bundle: Bundle, feature_of: Indices) -> None:
        limit = self._settings.inlier_sigmas
        for k, frame in enumerate(frames):
            mine = bundle.camera_of == k
            sightings = Sightings(
                bundle.points[bundle.point_of[mine]], bundle.seen[mine], bundle.sigmas[mine]
            )
            bad = ~inliers(frame.map_from_camera, sightings, limit)
            features = feature_of[mine][bad]
            np.subtract.at(self._sightings, frame.point_of[features], 1)
            frame.point_of[features] = -1


def _motions_between(frames: list[Keyframe]) -> RelativePoses | None:
    """What was expected of the motions between those that followed each other."""
    places = {frame.number: k for k, frame in enumerate(frames)}
    known = [
        (places[frame.number - 1], k, frame.motion)
        for k, frame in enumerate(frames)
        if frame.motion is not None and frame.number - 1 in places
    ]
    if not known:
        return None
    return RelativePoses(
        np.array([first for first, _, _ in known]),
        np.array([second for _, second, _ in known]),
        np.stack([motion.pose for _, _, motion in known]),
        np.stack([motion.information for _, _, motion in known]),
    )


def _count_seen(keyframe: Keyframe, seen: NDArray[np.bool_]) -> int:
    ids = keyframe.point_of
    return int(np.count_nonzero(seen[ids[ids >= 0]]))
