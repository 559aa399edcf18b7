"""The images of a map's nodes as a TUM RGB-D folder, which many tools read, this one among them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from formats.decimal_stamps import seconds_text
from formats.picture_files import encoded_file
from formats.trajectory_files import write_trajectory
from formats.whole_files import write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import ImageMessage, Node, NodeData, RgbdImage, Trajectory

Names = Literal["stamp", "id"]
PER_METRE = 5000  # TUM's unit of depth: a fifth of a millimetre
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG"


def write_images(
    folder: Path,
    items: Iterable[tuple[Node, NodeData, NDArray[np.float64]]],
    names: Names = "stamp",
) -> list[str]:
    """Writes rgb/, depth/, their lists, the calibration and the cameras' poses; gives what it could
    not write, one line each.

    `items`: node, data, map_from_base (4, 4). The first camera's files have TUM's names, those of
    the others a folder of their own. A damaged image is passed over. Raises `MapError` where the
    map keeps no images.
    """
    problems, lists, cameras = list[str](), dict[str, list[str]](), dict[str, dict[str, Any]]()
    stamps, poses, truths = [], [], []
    for node, data, map_from_base in items:
        for number, image in enumerate(data.images):
            place = "" if number == 0 else f"camera_{number}/"
            cameras.setdefault(place or "camera_0/", _calibration(image))
            _write_pair(folder, place, node, image, names, lists, problems)
        if data.images:
            stamps.append(node.stamp_ns)
            base_from_camera = data.images[0].camera.base_from_camera
            poses.append(map_from_base @ base_from_camera)
            if node.ground_truth is not None:
                truths.append((node.stamp_ns, node.ground_truth @ base_from_camera))
    if not stamps:
        raise MapError(f"{folder}: the map keeps no images, so none were written")
    for name, lines in lists.items():
        write_whole(folder / f"{name}.txt", "\n".join(["# timestamp filename", *lines, ""]))
    _write_calibration(folder, cameras)
    _write_poses(folder / "camera_poses.tum", list(zip(stamps, poses, strict=True)))
    if truths:
        _write_poses(folder / "groundtruth.txt", truths)
    return problems


def _write_poses(path: Path, poses: list[tuple[int, NDArray[np.float64]]]) -> None:
    stamps = np.array([stamp_ns for stamp_ns, _ in poses], np.int64)
    write_trajectory(path, Trajectory(stamps, np.stack([pose for _, pose in poses])))


def _write_calibration(folder: Path, cameras: dict[str, dict[str, Any]]) -> None:
    """All cameras as JSON; the first one's numbers in one line, which readers of TUM's take."""
    write_whole(folder / "calibration.json", json.dumps(cameras, indent=2) + "\n")
    first = next(iter(cameras.values()))
    numbers = [first[name] for name in ("fx", "fy", "cx", "cy")] + first["distortion"]
    line = " ".join(repr(number) for number in numbers)
    write_whole(folder / "camera.txt", f"# fx fy cx cy, then distortion\n{line}\n")


def _write_pair(
    folder: Path,
    place: str,
    node: Node,
    image: RgbdImage,
    names: Names,
    lists: dict[str, list[str]],
    problems: list[str],
) -> None:
    for kind, picture in (("rgb", image.colour), ("depth", image.depth)):
        if picture is None:
            continue
        name = str(node.id) if names == "id" else seconds_text(picture.stamp_ns)
        try:
            suffix, data = _depth_file(picture) if kind == "depth" else _colour_file(picture)
        except MapError as error:
            problems.append(str(error))
            continue
        listed = lists.setdefault(f"{place}{kind}", [])
        line = f"{seconds_text(picture.stamp_ns)} {kind}/{name}{suffix}"
        if line in listed[-9:]:  # several nodes of one moment
            name = f"{name}_{node.id}"
            line = f"{seconds_text(picture.stamp_ns)} {kind}/{name}{suffix}"
        file = f"{place}{kind}/{name}{suffix}"
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / file, data)
        listed.append(line)


def _colour_file(picture: ImageMessage) -> tuple[str, bytes]:
    """The stored file as it is; else PNG, which loses nothing."""
    if picture.encoded is not None and picture.encoded.startswith((_JPEG, _PNG)):
        return (".jpg" if picture.encoded.startswith(_JPEG) else ".png"), picture.encoded
    pixels = np.asarray(picture.pixels(), np.uint8)
    if pixels.ndim == 3:
        pixels = pixels[..., ::-1]
    return ".png", encoded_file(".png", pixels)


def _depth_file(picture: ImageMessage) -> tuple[str, bytes]:
    """16-bit PNG in TUM's unit; what lies beyond 13.1 m does not fit and becomes 0."""
    steps = np.rint(np.nan_to_num(np.asarray(picture.pixels(), np.float64)) * PER_METRE)
    steps[(steps < 0) | (steps > np.iinfo(np.uint16).max)] = 0
    return ".png", encoded_file(".png", steps.astype(np.uint16))


def _calibration(image: RgbdImage) -> dict[str, Any]:
    camera = image.camera
    k = camera.intrinsics
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": float(k[0, 0]),
        "fy": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "distortion_model": camera.distortion_model,
        "distortion": camera.distortion.tolist(),
        "depth_per_metre": PER_METRE,
        "base_from_camera": camera.base_from_camera.tolist(),
    }
