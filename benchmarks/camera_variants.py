"""Makes a sequence that nobody recorded of a TUM RGB-D folder, and its truth.

    python benchmarks/camera_variants.py FOLDER -o OUT --mirror --backwards --every 2 --half --flip
    python benchmarks/rgbd.py OUT

Mirrored left and right, upside down (--flip), played backwards, of every n-th frame from --first
on, or in half the size: the images are real, but what suits the recorded one need not suit these.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from spoil import listed

from formats.logs.tum_calibration import calibration_of
from formats.trajectory_files import read_trajectory, write_trajectory
from mapmyworld.types import Trajectory

Image = NDArray[Any]
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])  # of the camera's frame, and of the world's
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])  # about the lens


@dataclass(frozen=True)
class Change:
    mirror: bool
    flip: bool
    backwards: bool
    half: bool

    def picture(self, image: Image) -> Image:
        if self.flip:
            image = image[::-1, ::-1]
        if self.mirror:
            image = image[:, ::-1]
        if not self.half:
            return np.ascontiguousarray(image)
        if image.dtype == np.uint16:  # depth is measured, not mixed
            return np.ascontiguousarray(image[::2, ::2])
        size = image.shape[1] // 2, image.shape[0] // 2
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))

    def camera(self, numbers: list[float], width: int, height: int) -> list[float]:
        """Of fx fy cx cy and k1 k2 p1 p2 k3; p1 goes with rows, p2 with columns."""
        fx, fy, cx, cy, *lens = [*numbers, *([0.0] * 5)][:9]
        if self.flip:
            cx, cy, lens[2], lens[3] = width - 1 - cx, height - 1 - cy, -lens[2], -lens[3]
        if self.mirror:
            cx, lens[3] = width - 1 - cx, -lens[3]
        if self.half:
            fx, fy, cx, cy = fx / 2, fy / 2, (cx - 0.5) / 2, (cy - 0.5) / 2
        return [fx, fy, cx, cy, *lens]

    def truth(self, world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.flip:
            world_from_camera = world_from_camera @ _HALF_TURN
        if self.mirror:
            world_from_camera = _MIRROR @ world_from_camera @ _MIRROR
        return world_from_camera


def make(folder: Path, output: Path, change: Change, frames: slice) -> None:
    truth = read_trajectory(folder / "groundtruth.txt")
    turned = int(truth.stamps_ns[0] + truth.stamps_ns[-1])
    seconds = _backwards(turned) if change.backwards else float
    for name in ("rgb", "depth"):
        (output / name).mkdir(parents=True, exist_ok=True)
        rows = []
        for stamp, path in listed(folder, name)[frames]:
            picture = change.picture(cv2.imread(str(folder / path), cv2.IMREAD_UNCHANGED))
            at = f"{seconds(stamp):.6f}"
            cv2.imwrite(str(output / name / f"{at}.png"), picture)
            rows.append(f"{at} {name}/{at}.png")
        text = "\n".join(["# timestamp filename", *sorted(rows), ""])
        (output / f"{name}.txt").write_text(text)
    stamps, poses = truth.stamps_ns, change.truth(truth.poses)
    if change.backwards:
        stamps, poses = turned - stamps[::-1], poses[::-1]
    write_trajectory(output / "groundtruth.txt", Trajectory(stamps, poses))
    known, _ = calibration_of(folder)
    numbers = change.camera([*known], 640, 480)
    (output / "camera.txt").write_text(" ".join(map(str, numbers)) + "\n")


def _backwards(turned: int) -> Callable[[str], float]:
    return lambda stamp: turned * 1e-9 - float(stamp)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    for name in ("mirror", "flip", "backwards", "half"):
        parser.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    a = parser.parse_args()
    change = Change(a.mirror, a.flip, a.backwards, a.half)
    make(a.folder, a.output, change, slice(a.first, None, a.every))


if __name__ == "__main__":
    main()
