"""Depth against laser and floor, depth against colour, and the camera's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from mapmyworld.config import Config
from mapmyworld.diagnosis.depth_motion import (
    depth_motion_findings,
    in_scale,
    pairs_along_the_path,
)
from mapmyworld.diagnosis.depth_on_colour import alignment_findings, grey_levels
from mapmyworld.diagnosis.depth_on_laser import DEPTH_SCALE, mount_findings
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.diagnosis.rotation import time_offset
from mapmyworld.diagnosis.sample import odometry_yaw
from mapmyworld.geometry import Array
from mapmyworld.mapping.depth_grid import floor_plane
from mapmyworld.mapping.level_surfaces import joined, surfaces_of
from mapmyworld.parallel import in_threads
from mapmyworld.sensing.plan import Plan
from mapmyworld.sensing.sound_images import ImageGuard, decoded
from mapmyworld.types import Frame, RgbdImage

_IMAGES = 12  # that are looked at closely, spread over the sample
_PROFILES = 200  # neighbouring images whose columns are compared
_TILT = 2.0  # deg
_HEIGHT = 0.05  # m


def camera_findings(
    odom_from_base: Sequence[Array | None],
    frame_at: Callable[[int], Frame],
    plan: Plan,
    config: Config,
) -> Iterator[Finding]:
    """What depth and colour images indicate about units and mounts.

    Of the frames at some of the poses (4, 4), by their number; those without an image are passed
    over.
    """
    spread = np.unique(np.linspace(0, len(odom_from_base) - 1, _IMAGES).astype(int))
    frames = [frame_at(i) for i in spread.tolist()]
    yield from _image_findings([frame for frame in frames if frame.images], plan, config)
    if plan.scan is None and plan.odometry is not None:
        found = pairs_along_the_path(odom_from_base)
        pairs = [(frame_at(i), frame_at(k)) for i, k in found]
        yield from depth_motion_findings(
            [(a, b) for a, b in pairs if a.images and b.images], config
        )


def _image_findings(frames: Sequence[Frame], plan: Plan, config: Config) -> Iterator[Finding]:
    """What the first image of each of these frames says by itself and beside its scan."""
    guard = ImageGuard()

    def look(frame: Frame) -> tuple[Frame, RgbdImage | None]:
        image = guard.sound(guard.guarded(frame.images[0]))
        if image is not None:  # decoded now: every comparison asks for its parts again
            image = replace(image, colour=decoded(image.colour), depth=decoded(image.depth))
        return frame, image

    chosen = [
        (frame, image)
        for frame, image in in_threads(look, frames, 0)
        if image is not None and image.colour is not None and image.depth is not None
    ]
    images = [image for _, image in chosen]
    beside = list(alignment_findings(images))
    scale = 1.0
    if plan.scan is not None:
        aligned = all(finding.good for finding in beside)
        for finding in mount_findings(chosen, plan.scan.base_from_lidar, aligned=aligned):
            scale = finding.value if finding.name == DEPTH_SCALE else scale
            yield finding
    yield from _floor(images, scale, config)
    yield from beside


def _floor(images: list[RgbdImage], scale: float, config: Config) -> Iterator[Finding]:
    """Tilt and height of the floor in view, of depth so scaled."""
    seen = joined(surfaces_of(in_scale(image, scale), np.eye(4), config) for image in images)
    found = floor_plane(seen.points, seen.normals[:, 2])
    if found is None:
        return
    plane, lie_on = found
    tilt, height = float(np.degrees(np.arctan(np.hypot(*plane[:2])))), float(plane[2])
    good = tilt < _TILT and abs(height) < _HEIGHT
    text = (
        f"the floor is tilted by {tilt:.1f} deg and lies {height:+.3f} m high "
        f"({np.count_nonzero(lie_on)} points)"
    )
    suggestion = "correct the camera's mount (tf, or sensing.camera_mount) by as much"
    yield Finding("floor tilt", tilt, "deg", good, text, suggestion)


def camera_clock(framed: Sequence[Frame], plan: Plan, first_ns: int) -> Iterator[Finding]:
    """Turns that frames with images saw, from how columns move, against the odometry's.

    Times count from `first_ns`.
    """
    clock, guard = odometry_yaw(plan, first_ns), ImageGuard()
    if clock is None:
        return
    stamps, profiles = list[float](), list[Array]()
    for frame in framed[:_PROFILES]:
        colour = guard.guarded(frame.images[0]).colour
        if colour is None:
            continue
        stamps.append((colour.stamp_ns - first_ns) * 1e-9)
        grey = grey_levels(colour.pixels())
        third = len(grey) // 3
        profiles.append(grey[third : len(grey) - third].mean(axis=0, keepdims=True))
    if len(profiles) < 2:
        return
    focal = float(framed[0].images[0].camera.intrinsics[0, 0])
    window = np.hanning(profiles[0].shape[1])[None]
    shifts = [cv2.phaseCorrelate(a, b, window)[0][0] for a, b in pairwise(profiles)]
    turns = np.arctan(np.array(shifts) / focal)
    times = np.array(stamps)
    finding = time_offset(("camera", "odometry"), times[:-1], times[1:], turns, clock)
    if finding is not None:
        yield finding
