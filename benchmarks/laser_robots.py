"""Maps of robots drawn at random: their lasers, wheels and driving, in one of three worlds each.

    python benchmarks/laser_robots.py 0 40        # robots 0 to 39
    python benchmarks/laser_robots.py 11 --set laser.noise=0.01 --set world=office

What one default configuration makes of sensors that nobody had in mind; the truth is known.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
from pathlib import Path
from typing import Any

from common import scores_of, tool

WORLDS = ["apartment", "apartment", "hall", "office"]
DRAWN: dict[str, list[Any]] = {
    "laser.rate": [5, 7, 10, 20, 40],
    "laser.beams": [90, 181, 360, 541, 720, 1081],
    "laser.field_of_view": [120, 180, 240, 270, 359],
    "laser.range_max": [3.5, 5.6, 8, 12, 30],
    "laser.noise": [0.003, 0.01, 0.03],
    "laser.mount_x": [-0.15, 0.0, 0.12, 0.2],
    "laser.dropout": [0, 0.002, 0.1],
    "odometry.imbalance": [0.0006, 0.003, -0.005],
    "odometry.radius_error": [0.003, 0.03, -0.05],
    "odometry.noise": [0.002, 0.01],
    "odometry.rate": [10, 30, 100],
    "odometry.slip_rate": [0.02, 0.2],
    "driver.speed": [0.3, 0.6, 1.2],
    "driver.turn_rate": [0.5, 0.9, 1.8],
    "clock.stamp_jitter": [0.0005, 0.003],
}
SHOWN = list(DRAWN)[:5]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("end", type=int, nargs="?", help="one beyond the last; one robot without")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    options = parser.parse_args()
    changes = dict(change.split("=", 1) for change in options.changes)
    names = " | ".join(name.split(".")[1].replace("_", " ") for name in SHOWN)
    print(f"| robot | world, laps | {names} | ATE m | max m | deg | closures | wrong | CPU s |")
    print("| --- " * (len(SHOWN) + 8) + "|")
    with tempfile.TemporaryDirectory(prefix="robots-") as folder:
        for number in range(options.first, options.end or options.first + 1):
            print(row(number, changes, Path(folder)), flush=True)


def row(number: int, changes: dict[str, str], folder: Path) -> str:
    """One robot's line of the table."""
    world, laps, settings = robot(number)
    world = changes.get("world", world)
    settings |= {name: value for name, value in changes.items() if name != "world"}
    head = f"| {number} | {world}, {laps} | " + " | ".join(str(settings[name]) for name in SHOWN)
    log, made = folder / "log.mcap", folder / "log.db"
    options = [word for name, value in settings.items() for word in ("--set", f"{name}={value}")]
    drive = ["simulate", world, "-o", log, "--no-camera", "--laps", laps, "--seed", number]
    driven = tool(*drive, "--overwrite", "-q", *options)
    if driven.returncode:
        return f"{head} | not driven: {driven.stderr.strip()} |"
    built = tool("build", log, "-o", made, "--overwrite", "-q", "--format", "json")
    if built.returncode:
        return f"{head} | exit code {built.returncode}: {built.stderr.strip()[-200:]} |"
    scores = scores_of(made, Path(f"{log}.truth/trajectory.tum"))
    ate, turned = scores["trajectory"]["ate"], scores["trajectory"]["ate_rotation_deg"]
    closures = scores["loops"]["count"]
    wrong = round(closures * (1.0 - scores["loops"]["precision"]))
    cpu = json.loads(built.stdout)["cpu_s"]
    errors = f"{ate['rmse']:.4f} | {ate['maximum']:.3f} | {turned['rmse']:.2f}"
    return f"{head} | {errors} | {closures} | {wrong} | {cpu:.1f} |"


def robot(number: int) -> tuple[str, int, dict[str, Any]]:
    """World, laps and settings of a robot."""
    draw = random.Random(number)
    world = draw.choice(WORLDS)
    settings = {name: draw.choice(values) for name, values in DRAWN.items()}
    return world, draw.choice([1, 2]), settings


if __name__ == "__main__":
    main()
