"""Intrinsics for a folder of the TUM RGB-D benchmark, which does not hold them itself."""

from __future__ import annotations

import re
from pathlib import Path

from mapmyworld.errors import LogError

# Published at https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats, by robot:
# fx fy cx cy, then k1 k2 p1 p2 k3.
_PUBLISHED = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
_DEFAULT = (525.0, 525.0, 319.5, 239.5)  # the ROS driver's, for a Kinect at 640 x 480
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


ASSUMED = "default of the driver"


def calibration_of(folder: Path) -> tuple[tuple[float, ...], str]:
    """Numbers (fx fy cx cy [pixels], then distortion) and where they are from.

    From camera.txt or calibration.yaml in the folder, else by its name, else `ASSUMED`. Raises
    LogError where a calibration file cannot be read.
    """
    for name in ("camera.txt", "calibration.txt"):
        if (folder / name).is_file():
            text = (folder / name).read_text("utf-8", "replace")
            plain = "\n".join(line.split("#")[0] for line in text.splitlines())
            return _checked(folder / name, list(map(float, re.findall(_NUMBER, plain)))), name
    for name in ("calibration.yaml", "camera.yaml"):
        if (folder / name).is_file():
            return _yaml_numbers(folder / name), name
    for robot, numbers in _PUBLISHED.items():
        short = robot.replace("reiburg", "r")  # fr1
        if re.search(rf"{robot}|(?:^|[^a-z]){short}(?:[^0-9]|$)", folder.resolve().name.lower()):
            return numbers, f"published for {robot}"
    return _DEFAULT, ASSUMED


def _yaml_numbers(path: Path) -> tuple[float, ...]:
    """Of camera_calibration's YAML (camera_matrix, distortion_coefficients), or `fx: 525` lines."""
    text = path.read_text("utf-8", "replace")
    named = dict(re.findall(rf"\b(fx|fy|cx|cy)\s*:\s*({_NUMBER})", text))
    if len(named) == 4:
        return _checked(path, [float(named[name]) for name in ("fx", "fy", "cx", "cy")])
    matrix = _yaml_data(text, "camera_matrix")
    if len(matrix) != 9:
        raise LogError(f"{path}: no camera_matrix of nine numbers and no fx, fy, cx, cy in it")
    focal = [matrix[0], matrix[4], matrix[2], matrix[5]]
    return _checked(path, focal + _yaml_data(text, "distortion_coefficients"))


def _yaml_data(text: str, name: str) -> list[float]:
    found = re.search(rf"{name}\s*:.*?data\s*:\s*\[(.*?)\]", text, re.DOTALL)
    return [float(word) for word in re.findall(_NUMBER, found.group(1))] if found else []


def _checked(path: Path, numbers: list[float]) -> tuple[float, ...]:
    if len(numbers) < 4 or min(numbers[:2]) <= 0:
        raise LogError(
            f"{path}: fx fy cx cy [distortion ...] expected, {len(numbers)} numbers found"
        )
    return tuple(numbers)
