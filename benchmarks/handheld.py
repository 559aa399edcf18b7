"""Records a camera carried by hand through a simulated world, as a folder like the TUM benchmark's.

    python benchmarks/handheld.py desk -o hand_desk --seconds 15
    python benchmarks/rgbd.py hand_desk

30 Hz, 640 x 480, motion blur, noise, and depth taken some milliseconds after the colour. "desk"
sweeps over a few square metres, "room" turns once around, "spin" turns fast on the spot,
"walk" goes once through the flat and comes back.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.trajectory_files import write_trajectory
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.simulation import SimulationSettings
from mapmyworld.simulation.image_messages import disturb_colour, disturb_depth, exposure_at
from mapmyworld.simulation.robot import intrinsics
from mapmyworld.simulation.simulated_camera import Renderer
from mapmyworld.simulation.world import build_scene
from mapmyworld.simulation.worlds import WORLDS
from mapmyworld.types import Trajectory

Array, Image = NDArray[np.float64], NDArray[np.uint8]
_EXPOSURE = 0.012  # s during which a picture is taken
_LAG = 0.009  # s from colour to depth, as between the Kinect's two cameras
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # optical, looking along x
_STEPS = 2  # views of which a blurred picture is the mean
_UNITS = 5000.0  # of depth a metre


@dataclass(frozen=True)
class Hand:
    """A smooth path with the tremble of a hand."""

    centre: tuple[float, float, float]
    reach: tuple[float, float, float]
    """m by which the path leaves the centre, along x, y, z."""
    period: float
    """s of the slowest movement."""
    heading: float
    swing: float
    """rad by which the heading swings to either side."""
    turns: float = 0.0
    """Full turns over the whole recording."""

    def pose(self, t: float, length: float) -> Array:
        """world_from_optical (4, 4) at t seconds of `length`."""
        w = 2.0 * np.pi / self.period
        way = np.array([np.sin(w * t), np.sin(2 * w * t + 0.6), np.sin(1.3 * w * t + 1.0)])
        tremble = 0.004 * np.sin(2.0 * np.pi * np.array([1.9, 2.3, 2.9]) * t + [0.0, 1.0, 2.0])
        yaw = self.heading + self.swing * np.sin(0.8 * w * t + 0.3)
        yaw += 2.0 * np.pi * self.turns * t / length
        pitch = 0.18 + 0.15 * np.sin(1.7 * w * t) + 0.012 * np.sin(12.0 * t)
        roll = 0.12 * np.sin(1.1 * w * t + 0.5) + 0.01 * np.sin(14.0 * t)
        turned = so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.0, pitch, 0.0]) @ so3_exp([roll, 0.0, 0.0])
        place = np.array(self.centre) + np.array(self.reach) * way + tremble
        return make_transform(turned @ LEVEL, place)


HANDS = {
    "desk": Hand((2.2, 0.4, 1.2), (0.6, 0.5, 0.2), 9.0, -0.6, 0.8),
    "room": Hand((2.0, 1.0, 1.3), (0.5, 0.6, 0.15), 14.0, 0.0, 0.2, turns=1.25),
    "spin": Hand((2.0, 1.0, 1.3), (0.08, 0.08, 0.05), 5.0, 0.4, 1.0),
    "walk": Hand((3.4, 1.5, 1.3), (3.0, 1.6, 0.1), 44.0, 0.0, 0.4, turns=2.0),
}


def record(hand: Hand, folder: Path, seconds: float, rate: float, world: str, seed: int) -> None:
    """Writes the folder."""
    settings = SimulationSettings()
    camera = Renderer(build_scene(WORLDS[world]), settings)
    times = np.arange(round(seconds * rate)) / rate
    gains = exposure_at(times, settings.camera, np.random.default_rng(seed))
    motion = partial(hand.pose, length=seconds)

    def shoot(k: int) -> tuple[Image, Array]:
        t, random = times[k], np.random.default_rng((seed, k))
        moments = t + np.linspace(-0.5, 0.5, _STEPS) * _EXPOSURE
        views = [camera.render(motion(float(m))) for m in moments]
        mean = np.mean([view.colour for view in views], axis=0).astype(np.uint8)
        colour = disturb_colour(mean, float(gains[k]), settings.camera, random)
        deep = camera.render(motion(float(t + _LAG)))
        return colour, disturb_depth(deep.depth, deep.slant, settings.camera, random)

    k = intrinsics(settings)
    write_folder(folder, times, _LAG, shoot, motion, [k[0, 0], k[1, 1], k[0, 2], k[1, 2]])


def write_folder(
    folder: Path,
    times: Array,
    lag: float,
    shoot: Callable[[int], tuple[Image, Array]],
    motion: Callable[[float], Array],
    numbers: Sequence[float],
) -> None:
    """Images, lists, truth and calibration, which are `numbers`, as the TUM benchmark has them.

    `shoot` gives the colour (H, W, 3) of each of the `times` (N,) and the depth (H, W) a `lag`
    later, `motion` world_from_optical (4, 4) at any time.
    """
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)

    def write(k: int) -> None:
        colour, depth = shoot(k)
        cv2.imwrite(str(folder / "rgb" / f"{1000 + times[k]:.6f}.jpg"), colour[..., ::-1])
        units = np.clip(np.rint(depth * _UNITS), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / "depth" / f"{1000 + times[k] + lag:.6f}.png"), units)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, range(len(times))))
    for name, suffix, late in (("rgb", "jpg", 0.0), ("depth", "png", lag)):
        lines = [f"{t:.6f} {name}/{t:.6f}.{suffix}" for t in 1000 + times + late]
        (folder / f"{name}.txt").write_text("\n".join(["# timestamp filename", *lines, ""]))
    stamps_ns = np.arange(0, round(1e9 * (times[-1] + 0.1)), 10_000_000)
    truth = Trajectory(1000 * 10**9 + stamps_ns, np.stack([motion(t * 1e-9) for t in stamps_ns]))
    write_trajectory(folder / "groundtruth.txt", truth)
    (folder / "camera.txt").write_text(" ".join(f"{n:.6f}" for n in numbers) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("motion", choices=list(HANDS))
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--world", choices=list(WORLDS), default="apartment")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    record(
        HANDS[options.motion],
        options.output,
        options.seconds,
        options.rate,
        options.world,
        options.seed,
    )


if __name__ == "__main__":
    main()
