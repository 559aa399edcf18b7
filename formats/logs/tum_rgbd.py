"""Folders of the TUM RGB-D benchmark as logs: colour, depth and true poses, matched by name.

`rgb.txt`, `depth.txt` and `groundtruth.txt` list `time file` or `time tx ty tz qx qy qz qw`; depth
PNGs hold 5000 units a metre (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from formats.decimal_stamps import stamp_from_text
from formats.image_folders import PER_METRE
from formats.logs.files import hash_files
from formats.logs.image_pixels import encoded_pixels
from formats.logs.listed_log import ListedLog
from formats.logs.poses import pose_matrix
from formats.logs.tum_calibration import ASSUMED, calibration_of
from formats.picture_files import picture_size
from mapmyworld.errors import LogError
from mapmyworld.types import (
    CameraModel,
    ImageMessage,
    Message,
    MessageKind,
    PoseMessage,
    RawMessage,
)

COLOUR, DEPTH = "/camera/rgb/image_color", "/camera/depth/image"
INFO, TRUTH = "/camera/rgb/camera_info", "/ground_truth"
FRAME, WORLD = "camera_rgb_optical_frame", "world"
# In the order in which messages of equal time come.
_TOPICS = {
    TRUTH: (MessageKind.POSE, "geometry_msgs/msg/PoseWithCovarianceStamped"),
    INFO: (MessageKind.CAMERA_INFO, "sensor_msgs/msg/CameraInfo"),
    COLOUR: (MessageKind.IMAGE, "sensor_msgs/msg/CompressedImage"),
    DEPTH: (MessageKind.IMAGE, "sensor_msgs/msg/Image"),
}
LISTS = ("rgb.txt", "depth.txt")


@dataclass(frozen=True, slots=True)
class _Entry:
    stamp_ns: int
    fields: tuple[bytes, ...]


class TumRgbdLog(ListedLog):
    """A LogSource over one folder; raises `LogError` where its lists name no images."""

    container = "TUM RGB-D folder"
    encoding = "files"
    type_names: ClassVar = {topic: name for topic, (_, name) in _TOPICS.items()}

    def _read(self) -> Callable[[], Iterator[RawMessage]]:
        lists = {
            COLOUR: self._entries("rgb.txt", 1),
            DEPTH: self._entries("depth.txt", 1),
            TRUTH: self._entries("groundtruth.txt", 7),
        }
        pictures = lists[COLOUR] or lists[DEPTH]
        if not pictures:
            raise LogError(f"{self.path}: rgb.txt and depth.txt list no images")
        self.pictures = [self._file(entry) for name in (COLOUR, DEPTH) for entry in lists[name]]
        size = picture_size(_bytes(self._file(pictures[0])))
        numbers, source = calibration_of(self.path)
        camera = _camera(numbers, size if size[0] else (640, 480))
        if source == ASSUMED:
            self.problems.append(
                f"{self.path}: no calibration in the folder and none known by its name: "
                "525 525 319.5 239.5 is assumed; put fx fy cx cy [d0 ...] into camera.txt beside it"
            )
        self.details.append(("calibration", source))
        decoders: dict[str, Callable[[_Entry], Message]] = {
            TRUTH: _pose,
            INFO: lambda entry: camera.info(entry.stamp_ns, FRAME),
            COLOUR: partial(self._picture, "rgb8"),
            # Metres; not `encoded`, because its 5000 units a metre are not ROS's millimetres.
            DEPTH: partial(self._picture, "32FC1"),
        }
        lists[INFO] = pictures
        every = [
            RawMessage(topic, kind, entry.stamp_ns, entry.stamp_ns, partial(decoders[topic], entry))
            for topic, (kind, _) in _TOPICS.items()
            for entry in lists[topic]
        ]
        every.sort(key=lambda raw: raw.log_time_ns)
        return partial(iter, every)

    def content_hash(self) -> str:
        names = "\n".join(str(path.relative_to(self.path)) for path in self._files())
        present = [path for path in self._files() if path.is_file()]
        return hashlib.sha256((names + hash_files(present)).encode()).hexdigest()

    def _entries(self, name: str, fields: int) -> list[_Entry]:
        """The entries of a list in time order; damaged lines are left out and reported."""
        path, entries, bad = self.path / name, list[_Entry](), list[int]()
        if not path.is_file():
            return entries
        for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
            words = line.replace(b",", b" ").split()
            if not words or words[0].startswith(b"#"):
                continue
            try:
                entry = _Entry(stamp_from_text(words[0]), tuple(words[1 : fields + 1]))
                if fields == 7:
                    if not line.endswith((b"\n", b"\r")):
                        raise ValueError("the line may end within a number")
                    _pose(entry)
                elif len(entry.fields) < fields or not self._file(entry).is_file():
                    raise ValueError("no such file")
            except (ValueError, LogError, OSError, RuntimeError):  # these two of names: see _file
                bad.append(number)
                continue
            entries.append(entry)
        if bad:
            self.problems.append(
                f"{path}: {len(bad)} line(s) skipped (damaged, cut, or their file is missing), the "
                f"first is line {bad[0]}"
            )
        return sorted(entries, key=lambda entry: entry.stamp_ns)

    def _file(self, entry: _Entry) -> Path:
        """Raises ValueError for a name that leads out of the folder.

        OSError for one that no file can have, RuntimeError for a link to itself.
        """
        file = self.path / os.fsdecode(entry.fields[0])
        if not file.resolve().is_relative_to(self.path.resolve()):
            raise ValueError("a file outside the folder")
        return file

    def _files(self) -> list[Path]:
        lists = [self.path / name for name in (*LISTS, "groundtruth.txt")]
        return [path for path in lists if path.is_file()] + self.pictures

    def _picture(self, encoding: str, entry: _Entry) -> ImageMessage:
        data, stamp_ns = _bytes(self._file(entry)), entry.stamp_ns
        pixels = partial(encoded_pixels, data, encoding, PER_METRE)
        file = data if encoding == "rgb8" else None
        return ImageMessage(stamp_ns, FRAME, encoding, *picture_size(data), pixels, file)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def _pose(entry: _Entry) -> PoseMessage:
    if len(entry.fields) < 7:
        raise LogError("a line of groundtruth.txt has less than eight numbers")
    values = [float(word) for word in entry.fields]
    if not np.isfinite(values).all():
        raise LogError("a pose of groundtruth.txt is not finite")
    return PoseMessage(entry.stamp_ns, WORLD, pose_matrix(values), np.zeros((6, 6)))


def _camera(numbers: tuple[float, ...], size: tuple[int, int]) -> CameraModel:
    """Of fx fy cx cy and distortion, and of that width and height."""
    k, distortion = np.eye(3), np.array(numbers[4:], np.float64)
    k[0, 0], k[1, 1], k[0, 2], k[1, 2] = numbers[:4]
    return CameraModel(*size, k, "plumb_bob" if len(distortion) else "", distortion, np.eye(4))
