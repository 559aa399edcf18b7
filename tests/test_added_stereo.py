"""Corners seen by both eyes of a stereo camera, with landmarks, in the back end."""

from __future__ import annotations

from pathlib import Path

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.backend.descent import solved
from mapmyworld.backend.factors import FactorGraph, factor_graph, poses_of
from mapmyworld.backend.system import System
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between, make_transform
from mapmyworld.geometry.rotations import rotation_angle

Image = NDArray[np.uint8]
SOME = slice(30, 40)  # pairs: 11 m of a street
COUNT = 10
CAMERA = gtsam.Cal3_S2Stereo(707.0912, 707.0912, 0.0, 601.8873, 183.1104, 0.53715)
AHEAD = 1.0  # m a frame, a guess: it is 1.2


def followed(image: Image, other: Image, corners: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Corners (C, 2) found again in another image, and which of them there and back."""
    given = corners.astype(np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(image, other, given, None, maxLevel=5)
    back, _, _ = cv2.calcOpticalFlowPyrLK(other, image, there, None, maxLevel=5)
    return there, (seen[:, 0] == 1) & (np.linalg.norm(back - given, axis=1) < 0.5)


def add_sightings(graph: FactorGraph, left: list[Image], right: list[Image], start: Array) -> int:
    """Corners of every third image, for as long as both eyes see them; how many there are."""
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(1.5), gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    )
    known = 0
    for first in range(0, len(left) - 1, 3):
        at = cv2.goodFeaturesToTrack(left[first], 300, 0.01, 12)[:, 0]
        alive, keys = np.ones(len(at), np.bool_), known + np.arange(len(at))
        for k in range(first, min(first + 4, len(left))):
            if k > first:
                at, seen = followed(left[k - 1], left[k], at)
                alive &= seen
            eye, seen = followed(left[k], right[k], at)
            alive &= seen & (at[:, 0] - eye[:, 0] > 2.0) & (np.abs(at[:, 1] - eye[:, 1]) < 1.5)
            for i in np.flatnonzero(alive).tolist():
                key = gtsam.symbol("l", int(keys[i]))
                point = gtsam.StereoPoint2(float(at[i, 0]), float(eye[i, 0]), float(at[i, 1]))
                if not graph.values.exists(key):
                    eyes = gtsam.StereoCamera(gtsam.Pose3(start[k]), CAMERA)
                    graph.values.insert(key, eyes.backproject(point))
                graph.factors.add(gtsam.GenericStereoFactor3D(point, noise, k, key, CAMERA))
        known += len(at)
    return known


def test_a_street_as_both_eyes_see_it(data: Path) -> None:
    log = open_log([data / "stereo" / "kitti_51.mcap"])
    left, right = (
        [m.decode().pixels() for m in log.messages([f"/stereo/{eye}/image_raw"])][SOME]
        for eye in ("left", "right")
    )
    true = read_trajectory(data / "stereo" / "kitti_51.truth.tum").poses[SOME]
    start = np.stack([make_transform(np.eye(3), [0.0, 0.0, AHEAD * k]) for k in range(COUNT)])
    none = np.zeros(0, np.int64)  # no edges: corners alone
    system = System(False, none, none, start[:0], np.zeros((0, 6, 6)), np.arange(COUNT))
    graph = factor_graph(system, start)
    graph.factors.addPriorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6))
    assert add_sightings(graph, left, right, start) > 500
    found = poses_of(system, solved(graph).values, start)
    missed = between(between(true[0], true), found)
    assert np.linalg.norm(missed[:, :3, 3], axis=1).max() < 0.2  # 2 %; the start misses by 1.8
    assert np.degrees(rotation_angle(missed)).max() < 0.2
