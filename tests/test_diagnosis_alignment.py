"""Depth that lies beside its colours is found in simulated and recorded images, and only then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from database_samples import camera

from formats.logs import open_log
from mapmyworld.config import Config
from mapmyworld.diagnosis import depth_on_colour as alignment
from mapmyworld.diagnosis.depth_on_colour import Displacement, alignment_findings
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.memory_log import MemoryLog
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.sensing.sound_images import ImageGuard
from mapmyworld.sensing.synchronise import read_frames
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import ImageMessage, LogSource, RgbdImage

Depth = np.ndarray
STARTS = {1: "start:2.6,-0.5,0 turn:350", 2: "start:0,2.6,90 turn:350", 3: "start:0,0,0 turn:350"}
UNREGISTERED = 13.1  # pixel metres: 525 pixels of focal length, 25 mm between infrared and colour


def images_of(log: LogSource) -> list[RgbdImage]:
    config = Config().sensing
    plan, guard = make_plan(survey_log(log), config), ImageGuard()
    seen = [frame.images[0] for frame in read_frames(log, plan, config) if frame.images]
    chosen = np.unique(np.linspace(0, len(seen) - 1, 12).astype(int))
    return [image for i in chosen if (image := guard.sound(guard.guarded(seen[i]))) is not None]


@cache
def turned_about(seed: int) -> list[RgbdImage]:
    """Images of a robot that turns about once, somewhere in the apartment."""
    settings = SimulationSettings()
    camera = replace(settings.camera, width=320, height=240, rate=1.0, compressed=False)
    settings = replace(settings, camera=camera, laser=replace(settings.laser, enabled=False))
    drive = simulate(find_world("apartment"), seed=seed, route=STARTS[seed], settings=settings)
    return images_of(MemoryLog(list(drive.messages())))


def reported(images: list[RgbdImage], change: Callable[[Depth], Depth]) -> Finding | None:
    def changed(depth: ImageMessage) -> ImageMessage:
        cells = change(np.asarray(depth.pixels(), np.float32))
        return replace(depth, pixels=lambda: cells)

    spoilt = [replace(i, depth=changed(i.depth)) for i in images if i.depth is not None]
    return next(alignment_findings(spoilt), None)


def moved(across: float, down: float, scale: float = 1.0) -> Callable[[Depth], Depth]:
    def change(depth: Depth) -> Depth:
        height, width = depth.shape
        rest = (1 - scale) * np.array([width, height]) / 2 + [across, down]
        matrix = np.column_stack([np.eye(2) * scale, rest])
        return np.asarray(cv2.warpAffine(depth, matrix, (width, height), flags=cv2.INTER_NEAREST))

    return change


def from_beside(depth: Depth) -> Depth:
    """As a camera saw it that stands to the left: the nearer, the farther to the right."""
    rows, columns = np.nonzero(depth > 0)
    distance = depth[rows, columns]
    places = np.rint(columns + UNREGISTERED / distance).astype(int)
    inside = places < depth.shape[1]
    seen = np.full_like(depth, np.inf)
    np.minimum.at(seen, (rows[inside], places[inside]), distance[inside])
    return np.where(np.isfinite(seen), seen, 0).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("seed", STARTS)
def test_depth_on_its_colours_is_found_sound(seed: int) -> None:
    found = reported(turned_about(seed), lambda depth: depth)
    assert found is not None
    assert found.good, found.text
    assert found.value <= 1.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", STARTS)
@pytest.mark.parametrize("shift", [(6, 0), (0, -5), (-6, 4), (14, 0)])
def test_depth_moved_beside_its_colours_is_measured(seed: int, shift: tuple[int, int]) -> None:
    found = reported(turned_about(seed), moved(*shift))
    assert found is not None
    assert not found.good
    assert found.value == pytest.approx(np.hypot(*shift), abs=1.5)
    assert "register" in found.suggestion


@pytest.mark.slow
@pytest.mark.parametrize("seed", STARTS)
def test_depth_of_another_angle_of_view_is_measured(seed: int) -> None:
    """Six parts in a hundred larger: 9.6 pixels at the sides."""
    found = reported(turned_about(seed), moved(0, 0, 1.06))
    assert found is not None
    assert not found.good
    assert found.value == pytest.approx(9.6, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", STARTS)
def test_depth_seen_from_beside_is_not_called_sound(seed: int) -> None:
    """Parallax moves near and far things differently: what is found is some mean of it, or none."""
    found = reported(turned_about(seed), from_beside)
    assert found is None or not found.good


def test_halves_of_the_images_that_disagree_say_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Edges of a picture without texture at its walls match by chance, each time elsewhere."""
    images = [RgbdImage(camera(), None, None)] * 8
    seen = iter(Displacement(1.0, *shift, 160.0) for shift in ((2, 0), (11, 1), (-11, -2)))
    monkeypatch.setattr(alignment, "image_edges", lambda image: image)
    monkeypatch.setattr(alignment, "coarse_overlaps", lambda images: np.zeros(len(images)))
    monkeypatch.setattr(alignment, "displacement", lambda *_: next(seen))
    assert list(alignment_findings(images)) == []


def test_upright_edges_alone_do_not_move_depth_up_or_down() -> None:
    """A post with a dark upper end: a little more of its depth lies on edges lower down."""
    post, rows = (np.abs(np.arange(320) - 140) < 40), np.arange(240)[:, None]
    near = np.where(post, 1.0, 3.0).astype(np.float32)
    grey = np.where(post & (rows >= 4), 200, 50).astype(np.uint8)
    depth = np.where(rows < 48, near, 0).astype(np.float32)
    colour = ImageMessage(0, "", "mono8", 320, 240, lambda: grey)
    beside = ImageMessage(0, "", "32FC1", 320, 240, lambda: depth)
    (found,) = alignment_findings([RgbdImage(camera(320, 240), colour, beside)] * 6)
    assert found.good, found.text
    assert found.value == 0.0


def test_pictures_without_edges_indicate_nothing() -> None:
    flat = turned_about(1)
    plain = [replace(i, depth=replace(i.depth, pixels=lambda: np.ones((240, 320)))) for i in flat]
    assert list(alignment_findings(plain)) == []
    assert list(alignment_findings([])) == []


@pytest.mark.slow
@pytest.mark.real_log
def test_a_recorded_kinect_is_found_sound_and_moved_is_not(data: Path) -> None:
    """Registered by its driver to about 2 of 640 pixels."""
    images = images_of(open_log([data / "rgbd" / "freiburg1_rpy_15hz"]))
    found = reported(images, lambda depth: depth)
    assert found is not None
    assert found.good, found.text
    found = reported(images, moved(12, -6))
    assert found is not None
    assert not found.good
    assert found.value == pytest.approx(np.hypot(12, 6), abs=5.0)
