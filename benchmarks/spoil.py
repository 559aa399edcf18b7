"""Makes a harder copy of a TUM RGB-D folder: blur, noise, holes, coarse depth, fewer frames.

    python benchmarks/spoil.py FOLDER -o OUT --blur 12 --holes 0.3 --every 2
    python benchmarks/rgbd.py OUT

What it does to each frame follows from --seed and the frame's number.
"""

from __future__ import annotations

import argparse
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.logs.tum_calibration import calibration_of

_UNITS = 5000.0  # of depth a metre
_DISPARITY = 580.0 * 0.075 * 8.0  # m: the Kinect's baseline in eighths of a pixel


@dataclass(frozen=True)
class Spoils:
    blur: float
    """Pixels of motion blur, at most; a third of the frames have more than two thirds of it."""
    noise: float
    """Grey values, standard deviation; it rolls on from line to line."""
    holes: float
    """Share of the depth that is missing, in blots."""
    coarse: bool
    """Whether depth comes in the steps of a Kinect's disparity."""
    dark: float
    """Share by which the brightness changes from frame to frame, at most."""


def spoil_colour(
    image: NDArray[np.uint8], spoils: Spoils, random: np.random.Generator
) -> NDArray[np.uint8]:
    length = max(1, round(spoils.blur * random.uniform()))
    kernel = np.zeros((length, length), np.float32)
    kernel[length // 2] = 1.0 / length
    middle = ((length - 1) / 2.0, (length - 1) / 2.0)
    turn = cv2.getRotationMatrix2D(middle, random.uniform(0.0, 180.0), 1.0)
    kernel = cv2.warpAffine(kernel, turn, (length, length))
    picture = cv2.filter2D(image, cv2.CV_32F, kernel / max(float(kernel.sum()), 1e-6))
    picture *= 1.0 + spoils.dark * random.uniform(-1.0, 1.0)
    rolling = np.cumsum(random.normal(0.0, 0.3, len(image)))
    rolling -= cv2.blur(rolling[:, None], (1, 61))[:, 0]
    picture += spoils.noise * rolling[:, None, None]
    picture += random.normal(0.0, 1.0, image.shape).astype(np.float32) * spoils.noise
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def spoil_depth(
    units: NDArray[np.uint16], spoils: Spoils, random: np.random.Generator
) -> NDArray[np.uint16]:
    depth = units.astype(np.float32) / _UNITS
    if spoils.coarse:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(depth > 0, _DISPARITY / np.rint(_DISPARITY / depth), 0.0)
    blots = cv2.resize(random.uniform(size=(24, 32)).astype(np.float32), units.shape[::-1])
    depth[blots < np.quantile(blots, spoils.holes)] = 0.0
    return np.asarray(np.clip(np.rint(depth * _UNITS), 0, 65535), np.uint16)


def listed(folder: Path, name: str) -> list[list[str]]:
    lines = (folder / f"{name}.txt").read_text().splitlines()
    return [line.split()[:2] for line in lines if line.strip() and line[0] != "#"]


def spoil(folder: Path, output: Path, spoils: Spoils, every: int, lag: float, seed: int) -> None:
    """Writes the spoiled copy; `lag` seconds are added to the stamps of the depth images."""
    for name in ("rgb", "depth"):
        (output / name).mkdir(parents=True, exist_ok=True)
        entries = listed(folder, name)[::every]
        rows = []

        def work(k: int, entries: list[list[str]] = entries, name: str = name) -> None:
            random = np.random.default_rng((seed, k, name == "depth"))
            image = cv2.imread(str(folder / entries[k][1]), cv2.IMREAD_UNCHANGED)
            done = (spoil_colour if name == "rgb" else spoil_depth)(image, spoils, random)
            cv2.imwrite(str(output / entries[k][1]), done)

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(work, range(len(entries))))
        shift = lag if name == "depth" else 0.0
        rows = [f"{float(stamp) + shift:.6f} {path}" for stamp, path in entries]
        (output / f"{name}.txt").write_text("\n".join(["# timestamp filename", *rows, ""]))
    shutil.copy(folder / "groundtruth.txt", output)
    numbers, _ = calibration_of(folder)
    (output / "camera.txt").write_text(" ".join(map(str, numbers)) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--blur", type=float, default=0.0)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--holes", type=float, default=0.0)
    parser.add_argument("--coarse", action="store_true")
    parser.add_argument("--dark", type=float, default=0.0)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--lag", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    spoils = Spoils(o.blur, o.noise, o.holes, o.coarse, o.dark)
    spoil(o.folder, o.output, spoils, o.every, o.lag, o.seed)


if __name__ == "__main__":
    main()
