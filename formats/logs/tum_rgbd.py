"""Folders of the TUM RGB-D benchmark as logs: colour, depth and true poses, matched by name.

`rgb.txt`, `depth.txt` and `groundtruth.txt` list `time file` or `time tx ty tz qx qy qz qw`; depth
PNGs hold 5000 units a metre (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
"""

from __future__ import annotations

import hashlib
import heapq
import os
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from formats.logs.files import hash_files
from formats.logs.image_pixels import encoded_pixels
from formats.logs.poses import pose_matrix
from formats.logs.text_stamps import stamp_from_text
from formats.logs.tum_calibration import Calibration, calibration_of
from formats.picture_files import picture_size
from mapmyworld.errors import LogError
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    LogInfo,
    Message,
    MessageKind,
    PoseMessage,
    RawMessage,
    TopicInfo,
)

COLOUR, DEPTH = "/camera/rgb/image_color", "/camera/depth/image"
INFO, TRUTH = "/camera/rgb/camera_info", "/ground_truth"
FRAME, WORLD = "camera_rgb_optical_frame", "world"
_DEPTH_UNITS = 5000.0  # a metre
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


class TumRgbdLog:
    """A LogSource over one folder; raises `LogError` where its lists name no images."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.problems: list[str] = []
        self._hash: str | None = None
        self.lists = {
            COLOUR: self._read("rgb.txt", 1),
            DEPTH: self._read("depth.txt", 1),
            TRUTH: self._read("groundtruth.txt", 7),
        }
        if not self.lists[COLOUR] and not self.lists[DEPTH]:
            raise LogError(f"{folder}: rgb.txt and depth.txt list no images")
        self.lists[INFO] = self.lists[COLOUR] or self.lists[DEPTH]
        size = self._picture_size()
        self.calibration = calibration_of(folder, size)
        if self.calibration.guessed:
            self.problems.append(
                f"{folder}: no calibration in the folder and none known by its name: "
                "525 525 319.5 239.5 is assumed; put fx fy cx cy [d0 ...] into camera.txt beside it"
            )

    def info(self) -> LogInfo:
        topics = tuple(self._topic(name) for name in sorted(_TOPICS) if self.lists[name])
        files = self._files()
        return LogInfo(
            (str(self.folder),),
            "TUM RGB-D folder",
            sum(path.stat().st_size for path in files if path.is_file()),
            sum(topic.count for topic in topics),
            min(topic.first_ns or 0 for topic in topics),
            max(topic.last_ns or 0 for topic in topics),
            topics,
            (("calibration", self.calibration.source),),
            tuple(self.problems),
        )

    def content_hash(self) -> str:
        if self._hash is None:
            names = "\n".join(str(path.relative_to(self.folder)) for path in self._files())
            present = [path for path in self._files() if path.is_file()]
            self._hash = hashlib.sha256((names + hash_files(present)).encode()).hexdigest()
        return self._hash

    def losses(self) -> tuple[str, ...]:
        return tuple(self.problems)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        wanted = [name for name in _TOPICS if topics is None or name in topics]
        streams = [self._messages(name) for name in wanted]
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def _messages(self, topic: str) -> Iterator[RawMessage]:
        kind = _TOPICS[topic][0]
        decoders: dict[str, Callable[[_Entry], Message]] = {
            TRUTH: _pose,
            INFO: self._camera_info,
            COLOUR: self._colour,
            DEPTH: self._depth,
        }
        decode = decoders[topic]
        for entry in self.lists[topic]:
            yield RawMessage(topic, kind, entry.stamp_ns, entry.stamp_ns, partial(decode, entry))

    def _read(self, name: str, fields: int) -> list[_Entry]:
        """The entries of a list in time order; damaged lines are left out and reported."""
        path, entries, bad = self.folder / name, list[_Entry](), list[int]()
        if not path.is_file():
            return entries
        for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
            words = line.replace(b",", b" ").split()
            if not words or words[0].startswith(b"#"):
                continue
            try:
                entry = _Entry(stamp_from_text(words[0]), tuple(words[1 : fields + 1]))
                if fields == 7:
                    _whole_pose(entry, line)
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
        file = self.folder / os.fsdecode(entry.fields[0])
        if not file.resolve().is_relative_to(self.folder.resolve()):
            raise ValueError("a file outside the folder")
        return file

    def _files(self) -> list[Path]:
        lists = [self.folder / name for name in (*LISTS, "groundtruth.txt")]
        images = [self._file(entry) for topic in (COLOUR, DEPTH) for entry in self.lists[topic]]
        return [path for path in lists if path.is_file()] + images

    def _picture_size(self) -> tuple[int, int]:
        first = (self.lists[COLOUR] or self.lists[DEPTH])[0]
        size = picture_size(_bytes(self._file(first)))
        return size if size[0] else (640, 480)

    def _topic(self, name: str) -> TopicInfo:
        kind, type_name = _TOPICS[name]
        entries = self.lists[name]
        return TopicInfo(
            name,
            type_name,
            kind,
            "files",
            len(entries),
            entries[0].stamp_ns,
            entries[-1].stamp_ns,
        )

    def _colour(self, entry: _Entry) -> ImageMessage:
        data = _bytes(self._file(entry))
        pixels = partial(encoded_pixels, data, "rgb8")
        return ImageMessage(entry.stamp_ns, FRAME, "rgb8", *picture_size(data), pixels, data)

    def _depth(self, entry: _Entry) -> ImageMessage:
        """Metres; no `encoded`, because its 5000 units a metre are not ROS's millimetres."""
        data = _bytes(self._file(entry))
        pixels = partial(encoded_pixels, data, "32FC1", _DEPTH_UNITS)
        return ImageMessage(entry.stamp_ns, FRAME, "32FC1", *picture_size(data), pixels)

    def _camera_info(self, entry: _Entry) -> CameraInfoMessage:
        return _camera_info(entry.stamp_ns, self.calibration)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def _whole_pose(entry: _Entry, line: bytes) -> None:
    """Raises ValueError where a line is none: one without its end may end within a number."""
    if not line.endswith((b"\n", b"\r")):
        raise ValueError("the line is cut")
    _pose(entry)


def _pose(entry: _Entry) -> PoseMessage:
    if len(entry.fields) < 7:
        raise LogError("a line of groundtruth.txt has less than eight numbers")
    values = [float(word) for word in entry.fields]
    if not np.isfinite(values).all():
        raise LogError("a pose of groundtruth.txt is not finite")
    return PoseMessage(entry.stamp_ns, WORLD, pose_matrix(values), np.zeros((6, 6)))


def _camera_info(stamp_ns: int, calibration: Calibration) -> CameraInfoMessage:
    k = np.eye(3)
    k[0, 0], k[1, 1], k[0, 2], k[1, 2] = calibration.focal_and_centre
    return CameraInfoMessage(
        stamp_ns,
        FRAME,
        *calibration.size,
        "plumb_bob" if len(calibration.distortion) else "",
        np.array(calibration.distortion, np.float64),
        k,
        np.eye(3),
        np.hstack([k, np.zeros((3, 1))]),
    )
