"""Records sequences like the TUM benchmark's, with a simulated Kinect carried around by hand.

    python benchmarks/tum_like.py desk -o sim_desk --seconds 12
    python benchmarks/rgbd.py sim_desk

Speeds are those that the benchmark states: xyz 0.24 m/s and 9 deg/s, desk 0.4 and 23, desk2 0.4
and 29, room 0.33 and 30, 360 0.2 and 42, office (a round about two desks) 0.25 and 10, plane
(a wall of posters, nothing else) 0.3 and 10. What the camera does wrong: see benchmarks/kinect.py.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from handheld import LEVEL, write_folder
from kinect import BENT, COLOUR, Faults, Kinect
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.simulation.solids import Box, Post, wall
from mapmyworld.simulation.world import Ground, World, build_scene

Array = NDArray[np.float64]


def _table(x: float, y: float, number: int) -> list[Box | Post]:
    """A cluttered desk, 1.6 x 0.8 m, the plan of the clutter from its number."""
    random = np.random.default_rng(number)
    parts: list[Box | Post] = [Box(x, y, 1.6, 0.8, 0.70, 0.74, "planks")]
    parts += [Box(x + s * 0.75, y, 0.05, 0.7, 0.0, 0.70, "wood") for s in (-1, 1)]
    for k in range(9):
        u, v = random.uniform(-0.7, 0.7), random.uniform(-0.32, 0.32)
        length, width, height = random.uniform(0.06, 0.3, 3) * [1.0, 0.7, 1.0]
        name = f"{('books', 'picture')[k % 2]}:{300 + 10 * number + k}"
        turn = float(random.uniform(0, 180))
        parts.append(
            Box(x + u, y + v, length, width, 0.74, 0.74 + height, name, turn, stretch=True)
        )
    parts.append(Box(x, y + 0.28, 0.5, 0.06, 0.85, 1.2, f"picture:{400 + number}", stretch=True))
    parts.append(Post(x + 0.6, y - 0.2, 0.04, 0.74, 0.86, "terracotta"))
    return parts


_ROOM = World(
    name="study",
    about="two cluttered desks back to back in a room of 6 x 5 m with posters",
    solids=(
        *wall((-3.0, -2.5), (3.0, -2.5), "plain:cream"),
        *wall((3.0, -2.5), (3.0, 2.5), "wallpaper:2"),
        *wall((3.0, 2.5), (-3.0, 2.5), "plain:white"),
        *wall((-3.0, 2.5), (-3.0, -2.5), "plain:white"),
        *_table(0.0, -0.42, 1),
        *_table(0.0, 0.42, 2),
        Box(2.7, 1.0, 0.35, 1.6, 0.0, 1.9, "books:7"),
        Box(-2.75, -1.2, 0.4, 0.9, 0.0, 1.2, "planks"),
        Box(-1.2, 2.42, 0.9, 0.03, 1.0, 1.7, "picture:331", stretch=True),
        Box(1.4, 2.42, 0.7, 0.03, 0.9, 1.7, "picture:332", stretch=True),
        Box(0.3, -2.42, 1.2, 0.03, 0.9, 1.6, "picture:333", stretch=True),
        Box(-2.92, 0.9, 0.8, 0.03, 0.9, 1.6, "picture:334", 90.0, stretch=True),
        Box(2.92, -1.3, 0.7, 0.03, 0.9, 1.6, "picture:335", 90.0, stretch=True),
    ),
    grounds=(Ground((-3.0, -2.5, 3.0, 2.5), "carpet", "plain:white"),),
)
_WALL = World(
    name="posters",
    about="a flat wall of posters",
    solids=(
        *wall((-4.0, 2.0), (4.0, 2.0), "plain:white"),
        *[
            Box(-3.4 + 0.85 * k, 1.93, 0.7, 0.01, 0.6, 1.6, f"picture:{340 + k}", stretch=True)
            for k in range(9)
        ],
    ),
    grounds=(Ground((-4.0, -3.0, 4.0, 2.5), "plain:grey"),),
)


@dataclass(frozen=True)
class Path3:
    """Where the hand goes, and what it looks at."""

    centre: tuple[float, float, float]
    reach: tuple[float, float, float]
    period: float  # s of the slowest movement
    target: tuple[float, float, float] | None = None
    """Looked at; without it `heading` counts."""
    heading: float = 0.0
    swing: float = 0.0  # rad
    turns: float = 0.0  # full ones over the recording
    pitch: float = 0.1
    nod: float = 0.1  # rad
    orbit: bool = False
    """Once around the centre at the reach of x and y, instead of to and fro."""
    world: World = _ROOM

    def pose(self, t: float, length: float) -> Array:
        """world_from_optical (4, 4) at t seconds of `length`."""
        w = 2.0 * np.pi / self.period
        way = np.array([np.sin(w * t), np.sin(1.37 * w * t + 0.6), np.sin(0.83 * w * t + 1.0)])
        if self.orbit:
            angle = 2.0 * np.pi * 1.08 * t / length - 2.2
            way[:2] = np.cos(angle), np.sin(angle)
        tremble = 0.003 * np.sin(2.0 * np.pi * np.array([1.9, 2.7, 3.4]) * t + [0.0, 1.0, 2.0])
        place = np.array(self.centre) + np.array(self.reach) * way + tremble
        yaw, pitch = self.heading, self.pitch
        if self.target is not None:
            ahead = np.array(self.target) - place
            yaw = float(np.arctan2(ahead[1], ahead[0]))
            pitch = float(np.arctan2(-ahead[2], np.hypot(ahead[0], ahead[1])))
        yaw += self.swing * np.sin(1.21 * w * t + 0.3) + 2.0 * np.pi * self.turns * t / length
        yaw += 0.012 * np.sin(13.0 * t)
        pitch += self.nod * np.sin(1.7 * w * t) + 0.012 * np.sin(16.0 * t)
        roll = 0.7 * self.nod * np.sin(1.1 * w * t + 0.5) + 0.01 * np.sin(14.0 * t)
        turned = so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.0, pitch, 0.0]) @ so3_exp([roll, 0.0, 0.0])
        return make_transform(turned @ LEVEL, place)


PATHS = {
    "xyz": Path3((-0.2, -1.7, 1.25), (0.3, 0.25, 0.25), 7.0, (0.0, -0.2, 0.8), nod=0.02),
    "desk": Path3((0.0, -1.5, 1.3), (0.9, 0.3, 0.2), 12.0, (0.1, -0.3, 0.8), swing=0.45),
    "desk2": Path3((0.1, -1.4, 1.25), (0.8, 0.35, 0.25), 9.0, (0.0, 0.0, 0.85), swing=0.6, nod=0.2),
    "room": Path3((0.3, -1.6, 1.35), (0.8, 0.3, 0.15), 14.0, turns=1.1, swing=0.2, pitch=0.2),
    "360": Path3((-1.2, -1.4, 1.3), (0.15, 0.15, 0.08), 9.0, turns=1.2, pitch=0.1, nod=0.06),
    "office": Path3((0.0, 0.0, 1.4), (1.9, 1.7, 0.1), 15.0, (0.0, 0.0, 0.85), orbit=True),
    "plane": Path3((0.0, 0.4, 1.1), (2.0, 0.3, 0.15), 20.0, heading=np.pi / 2, pitch=0.0, nod=0.04,
                   swing=0.12, world=_WALL),
}  # fmt: skip


def record(
    path: Path3,
    folder: Path,
    seconds: float,
    rate: float,
    lag: float,
    seed: int,
    faults: Faults | None = None,
) -> None:
    """Writes the folder."""
    camera = Kinect(build_scene(path.world), faults or Faults())
    random = np.random.default_rng(seed)
    motion = partial(path.pose, length=seconds)
    times = 0.1 + np.arange(round((seconds - 0.2) * rate)) / rate
    gains = _exposures(len(times), random)

    def shoot(k: int) -> tuple[NDArray[np.uint8], Array]:
        own = np.random.default_rng((seed, k))
        colour = camera.colour(motion, float(times[k]), float(gains[k]), own)
        return colour, camera.depth(motion, float(times[k]) + lag, own)

    numbers = [COLOUR[0, 0], COLOUR[1, 1], COLOUR[0, 2], COLOUR[1, 2], *BENT]
    write_folder(folder, times, lag, shoot, motion, numbers)


def _exposures(count: int, random: np.random.Generator) -> Array:
    """Brightness that wanders, and now and then jumps by an eighth."""
    jumps = np.cumsum((random.uniform(size=count) < 0.02) * random.normal(0.0, 0.12, count))
    wander = 0.08 * np.sin(np.arange(count) / 40.0 + random.uniform(0, 6))
    return np.asarray(np.clip(0.95 + wander + jumps - jumps.mean(), 0.5, 1.5))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("path", choices=list(PATHS))
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--lag", type=float, default=0.015, help="s from colour to depth")
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    record(PATHS[o.path], o.output, o.seconds, o.rate, o.lag, o.seed)


if __name__ == "__main__":
    main()
