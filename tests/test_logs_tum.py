"""Folders of the TUM RGB-D benchmark as logs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from formats.logs import open_log
from mapmyworld.errors import LogError
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import quaternion_to_rotation
from mapmyworld.types import CameraInfoMessage, ImageMessage, MessageKind, PoseMessage

RGB = np.random.default_rng(5).integers(0, 256, (6, 8, 3), np.uint8)
DEPTH = np.array([[0, 5000], [2500, 65535]], np.uint16)


def make(folder: Path, *, truth: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "rgb").mkdir()
    (folder / "depth").mkdir()
    cv2.imwrite(str(folder / "rgb" / "a.png"), RGB[..., ::-1])
    cv2.imwrite(str(folder / "depth" / "a.png"), DEPTH)
    (folder / "rgb.txt").write_text("# colour\n2.5 rgb/a.png\n1.000000001 rgb/a.png\n")
    (folder / "depth.txt").write_text("# depth\n1.25 depth/a.png\n")
    if truth:
        (folder / "groundtruth.txt").write_text("# t x y z q\n1.0 1 2 3 0 0 0.6 0.8\n")
    return folder


def test_everything_comes_in_time_order(tmp_path: Path) -> None:
    messages = list(open_log([make(tmp_path / "a")]).messages())
    assert [(m.topic, m.stamp_ns) for m in messages] == [
        ("/ground_truth", 1_000_000_000),
        ("/camera/rgb/camera_info", 1_000_000_001),
        ("/camera/rgb/image_color", 1_000_000_001),
        ("/camera/depth/image", 1_250_000_000),
        ("/camera/rgb/camera_info", 2_500_000_000),
        ("/camera/rgb/image_color", 2_500_000_000),
    ]


def test_pose_colour_and_depth_are_those_of_the_files(tmp_path: Path) -> None:
    found = {m.topic: m.decode() for m in open_log([make(tmp_path / "a")]).messages()}
    truth, colour = found["/ground_truth"], found["/camera/rgb/image_color"]
    depth = found["/camera/depth/image"]
    assert isinstance(truth, PoseMessage)
    expected = make_transform(quaternion_to_rotation([0, 0, 0.6, 0.8]), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(truth.pose, expected, atol=1e-15)
    assert isinstance(colour, ImageMessage)
    np.testing.assert_array_equal(colour.pixels(), RGB)
    assert colour.encoded == (tmp_path / "a" / "rgb" / "a.png").read_bytes()
    assert isinstance(depth, ImageMessage)
    assert depth.is_depth
    np.testing.assert_array_equal(depth.pixels(), np.float32([[0, 1.0], [0.5, 13.107]]))
    assert depth.encoded is None  # its units are not those of a recorded depth PNG


@pytest.mark.parametrize(
    ("name", "focal", "distortion"),
    [
        ("rgbd_dataset_freiburg1_xyz", 517.3, 5),
        ("freiburg2_desk", 520.9, 5),
        ("fr3_office", 535.4, 0),
        ("my_kinect", 525.0, 0),
    ],
)
def test_calibration_by_name(tmp_path: Path, name: str, focal: float, distortion: int) -> None:
    log = open_log([make(tmp_path / name)])
    info = next(log.messages({"/camera/rgb/camera_info"})).decode()
    assert isinstance(info, CameraInfoMessage)
    assert info.intrinsics[0, 0] == info.projection[0, 0] == focal
    assert len(info.distortion) == distortion
    assert (info.width, info.height) == (8, 6)
    guessed = any("assumed" in problem for problem in log.info().problems)
    assert guessed is (name == "my_kinect")


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("camera.txt", "# fx fy cx cy k1 k2\n300 301 4.5 3.5 0.1 0.2\n"),
        ("calibration.yaml", "fx: 300\nfy: 301.0\ncx: 4.5\ncy: 3.5\n"),
        (
            "camera.yaml",
            "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [300, 0, 4.5, 0, 301, 3.5, 0, 0, 1]\n"
            "distortion_coefficients:\n  rows: 1\n  data: [0.1, 0.2]\n",
        ),
    ],
)
def test_calibration_beside_the_images(tmp_path: Path, file: str, content: str) -> None:
    folder = make(tmp_path / "freiburg1_own")
    (folder / file).write_text(content)
    info = next(open_log([folder]).messages({"/camera/rgb/camera_info"})).decode()
    assert isinstance(info, CameraInfoMessage)
    k = info.intrinsics
    assert (k[0, 0], k[1, 1], k[0, 2], k[1, 2]) == (300, 301, 4.5, 3.5)
    assert info.distortion.tolist() in ([0.1, 0.2], [])


@pytest.mark.parametrize("content", ["", "1 2 3\n", "-1 2 3 4\n"])
def test_a_calibration_that_is_none_is_refused(tmp_path: Path, content: str) -> None:
    folder = make(tmp_path / "a")
    (folder / "camera.txt").write_text(content)
    with pytest.raises(LogError, match=r"camera\.txt.*expected"):
        open_log([folder])


def test_missing_images_and_damaged_lines_are_reported(tmp_path: Path) -> None:
    folder = make(tmp_path / "freiburg1")
    with (folder / "rgb.txt").open("a") as stream:
        stream.write("3.0 rgb/gone.png\nnot a line\n4.0\n")
    with (folder / "groundtruth.txt").open("a") as stream:
        stream.write("3.0 1 2\n4.0 nan 0 0 0 0 0 1\n")
    log = open_log([folder])
    assert len(list(log.messages())) == 6
    problems = log.info().problems
    assert ["3 line(s)" in line or "2 line(s)" in line for line in problems] == [True, True]


def test_names_that_no_file_can_have_cost_their_line_alone(tmp_path: Path) -> None:
    folder = make(tmp_path / "a")
    (folder / "ring.png").symlink_to("ring.png")
    with (folder / "rgb.txt").open("ab") as lines:
        lines.write(b"3.0 " + b"x" * 5000 + b"\n3.1 a\0b.png\n3.2 ring.png\n3.3 ../a/rgb/../../b\n")
    log = open_log([folder])
    assert log.info().topics[1].count == 2
    assert "4 line(s) skipped" in log.info().problems[0]


def test_an_image_that_is_none_disturbs_only_who_looks(tmp_path: Path) -> None:
    folder = make(tmp_path / "freiburg1")
    (folder / "depth" / "a.png").write_bytes(b"no picture")
    (message,) = open_log([folder]).messages({"/camera/depth/image"})
    image = message.decode()
    assert isinstance(image, ImageMessage)
    with pytest.raises(LogError, match="cannot be decoded"):
        image.pixels()


def test_a_folder_that_lists_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("# nothing\n")
    with pytest.raises(LogError, match="list no images"):
        open_log([tmp_path])


def test_the_hash_is_of_lists_and_images(tmp_path: Path) -> None:
    folder = make(tmp_path / "freiburg1")
    first = open_log([folder]).content_hash()
    assert open_log([folder]).content_hash() == first
    cv2.imwrite(str(folder / "rgb" / "a.png"), RGB)
    assert open_log([folder]).content_hash() != first


@pytest.mark.real_log
def test_the_real_folder_reads_completely(data: Path) -> None:
    log = open_log([data / "rgbd" / "freiburg1_rpy_15hz"])
    counts = {topic.topic: topic.count for topic in log.info().topics}
    assert counts["/camera/rgb/image_color"] == counts["/camera/depth/image"] == 339
    assert log.info().problems == ()
    for message in log.messages({"/camera/depth/image"}):
        image = message.decode()
        assert isinstance(image, ImageMessage)
        assert (image.width, image.height) == (640, 480)
    assert message.kind is MessageKind.IMAGE
    metres = image.pixels()
    assert metres.shape == (480, 640)
    assert 0.4 < np.median(metres[metres > 0]) < 5.0
