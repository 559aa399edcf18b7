"""Maps of cameras drawn at random: robots in one of five drives, and hands in a furnished room.

    python benchmarks/camera_robots.py 0 30               # robots 0 to 29
    python benchmarks/camera_robots.py 0 10 --hands       # hands 0 to 9
    python benchmarks/camera_robots.py 11 --set camera.noise=2 --build visual.feature_count=500

What one default configuration makes of sensors that nobody had in mind; the truth is known.
--keep FOLDER leaves the logs and the maps there, else they are deleted.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import scores_of, tool
from kinect import Faults
from tum_like import Path3, record

from formats.trajectory_files import read_trajectory
from mapmyworld.evaluation.relations_metric import poses_at

DRIVES: list[tuple[str, str, list[float]]] = [
    ("apartment", "default", [4, 6]),
    ("apartment", "2.6,-0.5 turn:180 0,0 turn:180 1.5,-0.2", [10, 15, 30]),
    ("hall", "default", [4, 6]),
    ("hall", "5,0 turn:180 0,0 turn:180 2,0", [10, 15]),
    ("office", "12,0 turn:180 0,0 turn:180", [5, 10]),
]
"""World, route, and the rates in Hz at which a log of it stays short."""
SENSORS: dict[str, tuple[list[str], list[str]]] = {
    "camera": (["--no-laser", "--set", "imu.enabled=false"], ["sensing.odometry_topic=none"]),
    "camera, IMU": (["--no-laser"], ["sensing.odometry_topic=none"]),
    "camera, wheels": (["--no-laser"], []),
    "all": (["--set", "laser.beams=360"], []),
}
"""How each is simulated, and built."""
DRAWN: dict[str, list[Any]] = {
    "camera.size": ["320x240", "424x240", "640x480", "640x480", "848x480"],
    "camera.field_of_view": [55, 65, 75, 90],
    "camera.depth_max": [3.5, 5, 8],
    "camera.depth_noise": [0.0008, 0.0015, 0.004],
    "camera.image_noise": [1, 2, 6],
    "camera.blur": [0.3, 0.5, 1.2],
    "camera.mount_pitch": [-10, 0, 0, 15, 30],
    "camera.mount_z": [0.05, 0.28, 0.9],
    "camera.mount_x": [-0.15, 0.0, 0.2],
    "camera.depth_min": [0.2, 0.4, 0.7],
    "camera.depth_edge": [0.05, 0.02],
    "camera.exposure_change": [0.02, 0.08, 0.3],
    "camera.compressed": [True, True, False],
    "camera.jpeg_quality": [50, 90],
    "camera.latency": [0.01, 0.04, 0.15],
    "odometry.imbalance": [0.0006, 0.003, -0.005],
    "odometry.radius_error": [0.003, 0.03, -0.05],
    "odometry.noise": [0.002, 0.01],
    "odometry.rate": [10, 30, 100],
    "odometry.slip_rate": [0.02, 0.2],
    "driver.speed": [0.4, 0.6, 1.0],
    "driver.turn_rate": [0.4, 0.9, 1.5],
    "imu.gyro_bias": [0.001, 0.01],
    "clock.stamp_jitter": [0.0005, 0.003],
}
SHOWN = ["camera.rate", *list(DRAWN)[:7], "driver.turn_rate"]
HEAD = ["sensors", "drive", *(name.split(".")[1].replace("_", " ") for name in SHOWN)]
HAND_HEAD = ["rate", "lag", "period", "turns", "exposure", "noise", "scale"]
SCORES = ["frames", "ATE m", "max m", "deg", "closures", "wrong", "recall", "CPU s", "MB", "exit"]
LEVEL = ["leans deg", "lies m"]


@dataclass(frozen=True)
class Robot:
    """A camera robot: what carries it, where it goes, and how it sees."""

    world: str
    route: str
    sensors: str
    settings: dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("end", type=int, nargs="?", help="one beyond the last; one robot without")
    parser.add_argument("--hands", action="store_true", help="cameras in hands instead")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    parser.add_argument("--build", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    changes = dict(change.split("=", 1) for change in options.changes)
    head = ["number", *(HAND_HEAD if options.hands else HEAD), *SCORES, *LEVEL]
    print(f"| {' | '.join(head)} |\n{'| --- ' * len(head)}|")
    for number in range(options.first, options.end or options.first + 1):
        kept = options.keep
        with nullcontext(kept) if kept else tempfile.TemporaryDirectory(prefix="cameras-") as at:
            log = Path(at) / f"{'hand' if options.hands else 'robot'}{number}"
            if options.hands:
                reported, log, wanted = hand_recorded(number, log)
            else:
                reported, log, wanted = robot_driven(robot(number), number, changes, log)
            print(
                f"| {number} | {reported} | {scored(log, [*wanted, *options.build])} |", flush=True
            )


def robot(number: int) -> Robot:
    """The robot of a number."""
    draw = random.Random(number)
    world, route, rates = draw.choice(DRIVES)
    settings = {"camera.rate": draw.choice(rates)}
    settings |= {name: draw.choice(values) for name, values in DRAWN.items()}
    return Robot(world, route, draw.choice(list(SENSORS)), settings)


def robot_driven(
    drawn: Robot, number: int, changes: dict[str, str], log: Path
) -> tuple[str, Path, list[str]]:
    """A robot's words for the table, its log, and how to build it."""
    settings = drawn.settings | {k: v for k, v in changes.items() if "." in k}
    world, sensors = changes.get("world", drawn.world), changes.get("sensors", drawn.sensors)
    route = changes.get("route", drawn.route)
    reported = [sensors, f"{world} {route[:7].split(',')[0]}", *(str(settings[n]) for n in SHOWN)]
    settings["camera.width"], settings["camera.height"] = settings.pop("camera.size").split("x")
    words = [w for name, value in settings.items() for w in ("--set", f"{name}={value}")]
    simulated, built = SENSORS[sensors]
    log = log.with_suffix(".mcap")
    drive = ["simulate", world, "-o", log, "--route", route, "--seed", number, "--overwrite"]
    driven = tool(*drive, "-q", *words, *simulated)
    if driven.returncode:
        raise SystemExit(driven.stderr)
    return " | ".join(reported), log, built


def hand_recorded(number: int, folder: Path) -> tuple[str, Path, list[str]]:
    """A hand's words for the table, its folder of images, and how to build it."""
    draw = random.Random(1000 + number)
    period, turns = draw.choice([5.0, 8.0, 14.0]), draw.choice([0.0, 0.0, 0.5, 1.1])
    path = Path3(
        centre=(draw.uniform(-1.2, 1.2), draw.choice([-1.6, 1.6]), draw.uniform(1.0, 1.6)),
        reach=(draw.uniform(0.1, 0.9), draw.uniform(0.1, 0.4), draw.uniform(0.05, 0.3)),
        period=period,
        target=None if turns else (0.0, 0.0, 0.8),
        heading=draw.uniform(-3.0, 3.0),
        swing=draw.uniform(0.1, 0.6),
        turns=turns,
        pitch=draw.uniform(0.0, 0.3),
        nod=draw.uniform(0.02, 0.25),
    )
    faults = Faults(
        exposure=draw.choice([0.004, 0.012, 0.025]),
        image_noise=draw.choice([1.0, 3.0, 7.0]),
        disparity_noise=draw.choice([0.03, 0.06, 0.15]),
        misplaced=(draw.uniform(-1.5, 1.5), draw.uniform(-1.5, 1.5)),
        depth_scale=draw.choice([0.99, 1.0, 1.005]),
    )
    rate, lag = draw.choice([7.5, 15.0, 15.0, 30.0]), draw.choice([0.0, 0.008, 0.015])
    record(path, folder, 4.0 + 60.0 / rate, rate, lag, number, faults)
    reported = [rate, lag, period, turns, faults.exposure, faults.image_noise, faults.depth_scale]
    return " | ".join(str(n) for n in reported), folder, []


def scored(log: Path, settings: list[str]) -> str:
    """What came of a log, as the end of its line."""
    made = log.with_suffix(".db")
    words = [w for setting in settings for w in ("--set", setting)]
    built = tool("build", log, "-o", made, "--overwrite", "-q", "--format", "json", *words)
    if built.returncode not in (0, 3):
        return f"exit code {built.returncode}: {built.stderr.strip()[-200:]}"
    beside = Path(f"{log}.truth") / "trajectory.tum"
    truth = beside if beside.exists() else log / "groundtruth.txt"
    scores = scores_of(made, truth)
    run, path, loops = json.loads(built.stdout), scores["trajectory"], scores["loops"]
    wrong = round(loops["count"] * (1.0 - (loops["precision"] or 0.0)))
    numbers = [
        run["frames"], f"{path['ate']['rmse']:.4f}", f"{path['ate']['maximum']:.3f}",
        f"{path['ate_rotation_deg']['rmse']:.2f}", loops["count"], wrong if loops["count"] else 0,
        "-" if loops["recall"] is None else f"{loops['recall']:.0%}", f"{run['cpu_s']:.0f}",
        f"{run['peak_memory_mb']:.0f}", built.returncode, *off_level(made, truth),
    ]  # fmt: skip
    return " | ".join(str(n) for n in numbers)


def off_level(made: Path, truth: Path) -> list[str]:
    """By how many degrees a map's z axis leans, and by how many metres it lies too high."""
    path, true = read_trajectory(made.with_suffix(".tum")), read_trajectory(truth)
    inside = (path.stamps_ns >= true.stamps_ns[0]) & (path.stamps_ns <= true.stamps_ns[-1])
    poses, expected = path.poses[inside], poses_at(true, path.stamps_ns[inside])
    up = (poses[:, :3, :3] @ expected[:, 2, :3, None])[..., 0].mean(axis=0)
    lean = np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2]))
    return [f"{lean:.2f}", f"{(poses[:, 2, 3] - expected[:, 2, 3]).mean():.3f}"]


if __name__ == "__main__":
    main()
