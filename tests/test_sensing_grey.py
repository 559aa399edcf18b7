"""16-bit grey images beside depth: mono16 is the encoding of either."""

from __future__ import annotations

import numpy as np
import pytest
from messages_in_memory import MemoryLog, camera_info_at, image_at, odometry_at, transform

from mapmyworld.config import SensingConfig
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.sensing.grey_images import is_grey
from mapmyworld.types import ImageMessage, Message

STEP = 100_000_000
Entries = list[tuple[str, Message, int]]


def mono16_at(stamp_ns: int, cells: np.ndarray) -> ImageMessage:
    """As readers give it: what could be millimetres, in metres."""
    metres = cells.astype(np.float32) / np.float32(1000.0)
    height, width = cells.shape
    return ImageMessage(stamp_ns, "camera_optical", "mono16", width, height, lambda: metres)


def drive(grey: str, depth: str, depth_encoding: str, cells: np.ndarray) -> Entries:
    entries: Entries = [("/tf_static", transform("base_link", "camera_optical", (0, 0, 0)), 0)]
    for i in range(5):
        time = (i + 1) * STEP
        entries += [
            ("/odom", odometry_at(time, (0.1 * i, 0, 0)), time),
            ("/cam/camera_info", camera_info_at(time), time),
            (grey, mono16_at(time, cells), time),
            (depth, image_at(time, depth_encoding), time),
        ]
    return entries


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_16_bit_picture_beside_depth_is_the_colour_image(bits: int) -> None:
    cells = np.linspace(0, (1 << bits) - 1, 64 * 48).astype(np.uint16).reshape(48, 64)
    log = MemoryLog(drive("/cam/rgb/image_raw", "/cam/depth/image_raw", "16UC1", cells))
    plan = make_plan(survey_log(log), SensingConfig())
    assert plan.camera is not None
    assert plan.camera.colour_topic == "/cam/rgb/image_raw"
    assert plan.camera.depth_topic == "/cam/depth/image_raw"
    frames = list(read_frames(log, plan, SensingConfig()))
    assert len(frames) == 5
    colour = frames[0].images[0].colour
    assert colour is not None
    assert not colour.is_depth
    np.testing.assert_array_equal(colour.pixels(), (cells >> (bits - 8)).astype(np.uint8))
    assert colour.pixels().dtype == np.uint8


def test_what_the_user_names_decides() -> None:
    cells = np.full((48, 64), 2000, np.uint16)
    log = MemoryLog(drive("/a", "/b", "mono16", cells))
    for colour, depth in (("/a", "/b"), ("/b", "/a")):
        config = SensingConfig(colour_topic=colour, depth_topic=depth)
        plan = make_plan(survey_log(log), config)
        assert plan.camera is not None
        assert (plan.camera.colour_topic, plan.camera.depth_topic) == (colour, depth)


@pytest.mark.parametrize(
    ("topic", "others", "grey"),
    [
        ("/cam/rgb", [("/cam/depth", "16UC1")], True),
        ("/cam/rgb", [("/cam/depth", "mono16")], True),
        ("/cam/ir", [("/cam/range", "32FC1")], True),
        ("/cam/depth", [("/other/depth", "16UC1")], False),
        ("/cam/range", [("/cam/ir", "mono16")], False),
        ("/cam/range", [], False),
    ],
)
def test_a_mono16_image_is_a_picture_where_another_one_is_depth(
    topic: str, others: list[tuple[str, str]], grey: bool
) -> None:
    assert is_grey(topic, "mono16", [(topic, "mono16"), *others]) == grey
    assert not is_grey(topic, "16UC1", others)
