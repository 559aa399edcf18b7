"""The keyframes around the camera and the points they saw: what the visual tracker looks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.rigid import between, transform_points
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.registration.views import View

_NEAREST = 20  # keyframes whose points are looked for
_KEPT = 200  # keyframes that are remembered


@dataclass(slots=True, eq=False)
class Keyframe:
    """A remembered view: where it was taken, and which map point each feature is (-1 = none)."""

    map_from_camera: Array
    """(4, 4)."""
    view: View
    point_of: Index
    """(N,) slots of points, one for each feature of the view."""


class LocalMap:
    """Points with their words, seen by keyframes. Slots of forgotten points are used again."""

    def __init__(self, config: Config) -> None:
        self._odometry = config.odometry
        self.keyframes: list[Keyframe] = []
        self.points = np.zeros((0, 3))
        self.words = np.zeros((0, 4), np.uint64)
        self._known = np.zeros(0)  # 1/m^2, of each point's place
        self._sightings = np.zeros(0, np.int64)  # by keyframes; 0 = slot free

    def near(self, map_from_camera: Array) -> Index:
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

    def add_keyframe(self, map_from_camera: Array, view: View, point_of: Index) -> Keyframe:
        """A new keyframe with the points its features were matched to; others with depth are new.

        A point lies where its sightings with depth have it in the mean, weighed by how well each
        knows the depth.
        `map_from_camera` is (4, 4); `point_of` (N,) gives the point of each feature, -1 for none.
        """
        keyframe = Keyframe(map_from_camera.copy(), view, point_of.copy())
        seen, known = transform_points(map_from_camera, view.camera_points()), _known(view)
        matched = np.flatnonzero(point_of >= 0)
        np.add.at(self._sightings, point_of[matched], 1)
        self.words[point_of[matched]] = view.words[matched]
        deep = matched[known[matched] > 0.0]
        self._average(point_of[deep], seen[deep], known[deep])
        fresh = np.flatnonzero((point_of < 0) & (known > 0.0))
        slots = self._free_slots(len(fresh))
        self.points[slots], self.words[slots] = seen[fresh], view.words[fresh]
        self._sightings[slots], self._known[slots] = 1, known[fresh]
        keyframe.point_of[fresh] = slots
        self.keyframes.append(keyframe)
        self._forget_doubted()
        if len(self.keyframes) > _KEPT:
            self._forget(self.keyframes.pop(0))
        return keyframe

    def _average(self, slots: Index, seen: Array, known: Array) -> None:
        """Points moved to where they were seen (K, 3) once more, known so well (K,)."""
        self._known[slots] += known
        share = known / self._known[slots]
        self.points[slots] += share[:, None] * (seen - self.points[slots])

    def _free_slots(self, count: int) -> Index:
        free = np.flatnonzero(self._sightings == 0)[:count]
        missing = count - len(free)
        if missing > 0:
            room = max(missing, 4096)
            start = len(self.points)
            self.points = np.concatenate([self.points, np.zeros((room, 3))])
            self.words = np.concatenate([self.words, np.zeros((room, 4), np.uint64)])
            self._sightings = np.concatenate([self._sightings, np.zeros(room, np.int64)])
            self._known = np.concatenate([self._known, np.zeros(room)])
            free = np.concatenate([free, np.arange(start, start + missing)])
        return free

    def _forget(self, keyframe: Keyframe) -> None:
        ids = keyframe.point_of[keyframe.point_of >= 0]
        np.subtract.at(self._sightings, ids, 1)

    def _forget_doubted(self) -> None:
        """Points of the keyframe before the last two that no other keyframe has seen since."""
        if len(self.keyframes) < 4:
            return
        old = self.keyframes[-4]
        known = np.flatnonzero(old.point_of >= 0)
        lonely = known[self._sightings[old.point_of[known]] == 1]
        self._sightings[old.point_of[lonely]] = 0
        old.point_of[lonely] = -1


def _known(view: View) -> Array:
    """(N,) 1/m^2, how well the depth of each feature is known; 0 without any."""
    inverse, sigma = view.seen[:, 2], view.sigmas[:, 1]
    return np.where(np.isfinite(inverse), np.square(inverse * inverse / sigma), 0.0)
