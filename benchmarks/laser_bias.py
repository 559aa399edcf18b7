"""How much too long a corridor comes out that scan after scan is matched along, and why.

    python benchmarks/laser_bias.py                                # 360 beams, 5.6 m, 3 cm of noise
    python benchmarks/laser_bias.py --noise 0 --beams 90 --range 30

Scans are taken from known poses in two corridors of the office, without motion or odometry, and
each is matched with one taken some way before it, from the true pose. Printed is the mean error
along the way in per cent of that way, weighted by what each match indicates it knows.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar
from mapmyworld.registration.scan_matching import ScanSet, match_scan, prepare_scans, scan_set
from mapmyworld.simulation.floor_plan import Plan, plan_at
from mapmyworld.simulation.world import build_scene
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import Scan

Array = NDArray[np.float64]
_HEIGHT = 0.25  # m, of the laser
_SPACING = 0.1  # m between poses
_AHEAD = (0.3, 0.6, 1.2, 2.4)  # m between two scans that are matched
_CORRIDORS = {"south": (-4.0, 34.0, 0.0, 0.0), "north": (34.0, -4.0, 20.5, np.pi)}
_WANDER = np.array([0.0, 0.15, 0.05])  # m and rad by which the robot is not in the middle


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=0.03)
    parser.add_argument("--beams", type=int, default=360)
    parser.add_argument("--range", type=float, default=5.6)
    parser.add_argument("--field-of-view", type=float, default=240.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    angles = np.radians(np.linspace(-0.5, 0.5, options.beams) * options.field_of_view)
    plan = plan_at(build_scene(find_world("office")), _HEIGHT)
    random = np.random.default_rng(options.seed)
    print("| corridor | " + " | ".join(f"{metres} m" for metres in _AHEAD) + " |")
    print("| --- " * (len(_AHEAD) + 1) + "|")
    for name, (start, end, y, yaw) in _CORRIDORS.items():
        xs = np.arange(start, end, np.copysign(_SPACING, end - start))
        poses = np.array([0.0, y, yaw]) + random.uniform(-1.0, 1.0, (len(xs), 3)) * _WANDER
        poses[:, 0] = xs
        sweeps = [sweep(plan, pose, angles, options.range, options.noise, random) for pose in poses]
        scans = prepare_scans(sweeps, Config().registration)
        errors = [f"{100.0 * bias(scans, poses, metres):+.2f} %" for metres in _AHEAD]
        print(f"| {name} | " + " | ".join(errors) + " |", flush=True)


def sweep(
    plan: Plan, pose: Array, angles: Array, reach: float, noise: float, random: np.random.Generator
) -> Scan:
    """What a laser at a pose (3,) sees at one moment."""
    rays = np.repeat(pose[None], len(angles), axis=0)
    rays[:, 2] += angles
    ranges = plan.cast(rays)[0] + noise * random.normal(size=len(angles))
    seen = ranges < reach
    points = ranges[seen, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)[seen]
    increment = float(angles[1] - angles[0])
    return Scan(points.astype(np.float32), np.zeros(3), np.zeros(0, np.float32), reach, increment)


def bias(scans: ScanSet, poses: Array, metres: float) -> float:
    """The weighted mean error along the way, as a share of it."""
    ahead = round(metres / _SPACING)
    errors, weights = [], []
    for first in range(len(poses) - ahead):
        truth = between_planar(poses[first], poses[first + ahead])
        found = match_scan(
            scans.one(first + ahead), scan_set([scans.one(first)]), np.zeros((1, 3)), truth,
            Config().registration,
        )  # fmt: skip
        errors.append(between_planar(truth, found.pose)[0])
        weights.append(found.information[0, 0])
    return float(np.average(errors, weights=weights) / metres)


if __name__ == "__main__":
    main()
