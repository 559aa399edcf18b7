"""Maps of simulated drives by a laser alone: without odometry, two laps, 181 beams and 12 m.

    python benchmarks/laser_alone.py office 14 18        # seeds 14 to 17

The error of all scans against the truth, and whether covariances know of it (NEES, 1 is honest).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from mapmyworld.api import build
from mapmyworld.evaluation.nees import map_nees
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.memory_log import MemoryLog
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.message_streams import ODOMETRY_TOPIC, TF_TOPIC
from mapmyworld.types import CLOSURES, Trajectory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("world", choices=["apartment", "hall", "office"])
    parser.add_argument("first", type=int)
    parser.add_argument("end", type=int, nargs="?", help="one beyond the last seed; one without")
    options = parser.parse_args()
    print("| world | seed | ATE m | max m | NEES | closures |\n" + "| --- " * 6 + "|")
    for seed in range(options.first, options.end or options.first + 1):
        print(row(options.world, seed), flush=True)


def row(world: str, seed: int) -> str:
    """One drive's line of the table."""
    settings = SimulationSettings()
    laser = replace(settings.laser, beams=181, field_of_view=180.0, range_max=12.0)
    settings = replace(settings, laser=laser, camera=replace(settings.camera, enabled=False))
    recording = simulate(world, seed=seed, laps=2, settings=settings)
    without = (ODOMETRY_TOPIC, TF_TOPIC)
    made = build(MemoryLog([m for m in recording.messages() if m[0] not in without])).map
    frames, poses, truth = made.frame_poses(), made.poses(), recording.truth.trajectory
    assert frames is not None
    assert poses is not None
    score = ate(Trajectory(made.tracked_frames().stamps_ns, frames), truth).translation
    nees = map_nees(tuple(made.nodes()), poses, truth)
    kept = sum(c.kind in CLOSURES and c.accepted for c in made.constraints())
    known = "" if nees is None else f"{nees:.1f}"
    return f"| {world} | {seed} | {score.rmse:.4f} | {score.maximum:.3f} | {known} | {kept} |"


if __name__ == "__main__":
    main()
