"""Accuracy, speed and memory of laser mapping on the recorded logs, and what each part gives.

python benchmarks/laser_logs.py [LOG...] [--data FOLDER] [--set KEY=VALUE]

A LOG is a name in the data's laser folder (intel, fr079, mit-csail) or a path. Where a file of
relations lies beside it, errors are the means of Kuemmerle et al. 2009. Closures are right within
0.20 m and 1 degree of the final poses (Hess et al. 2016). `--ablation` adds the errors of odometry
alone, matching, recognition, proximity; `--no-odometry` leaves odometry out.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import DATA

from cli.scoring import score_loops
from formats.database import open_store
from formats.logs import open_log
from formats.relation_files import read_relations
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.evaluation.relations_metric import relations_score
from mapmyworld.exporting import trajectory_of
from mapmyworld.graph.frame_poses import pose_every_frame
from mapmyworld.graph.solved_graph import solve
from mapmyworld.pipeline import build_map
from mapmyworld.types import CLOSURES, ConstraintKind, MapStore, Poses, Trajectory
from mapmyworld.types.maps import Relations


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("logs", nargs="*", default=["intel", "fr079", "mit-csail"])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--ablation", action="store_true")
    parser.add_argument("--no-odometry", action="store_true")
    arguments = parser.parse_args()
    config = apply_settings(Config(), dict(s.split("=", 1) for s in arguments.set))
    if arguments.no_odometry:
        config = replace(config, sensing=replace(config.sensing, odometry_topic="none"))
    print(
        f"{'log':<28}{'trans. m':>18}{'rot. deg':>18}"
        f"{'CPU s':>8}{'wall s':>8}{'x real':>8}{'MB':>6}"
    )
    for name in arguments.logs:
        run(name, arguments.data, config, ablation=arguments.ablation)


def run(name: str, data: Path, config: Config, *, ablation: bool) -> None:
    """Builds one log in a temporary folder and prints its rows."""
    path = Path(name)
    if not path.exists():
        path = data / "laser" / f"{name}.clf.bz2"
    relations_path = path.with_name(path.name.split(".")[0] + ".relations")
    relations = read_relations(relations_path) if relations_path.exists() else None
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(Path(folder) / "map.db", create=True)
        progress = Silent()
        cpu, wall = time.process_time(), time.monotonic()
        result = build_map(open_log([path]), store, config, progress)
        cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        frames = store.frame_poses()
        assert frames is not None
        errors = errors_of(store, frames, relations)
        speed = result.duration_s / wall
        print(f"{path.name.split('.')[0]:<28}{errors}{cpu:8.1f}{wall:8.1f}{speed:8.0f}{peak:6.0f}")
        print(f"    closures: {closures_of(store)}")
        for note in progress.notes:
            print(f"    {note}")
        if ablation:
            print_ablation(store, relations, config)
        store.close()


def errors_of(store: MapStore, map_from_frame: np.ndarray, relations: Relations | None) -> str:
    """Mean and standard deviation of both errors, as two columns."""
    if relations is None:
        return f"{'-':>18}{'-':>18}"
    stamps = store.tracked_frames().stamps_ns
    score = relations_score(Trajectory(stamps, map_from_frame), relations)
    return (
        f"{score.translation.mean:9.4f} +-{score.translation.std:6.4f}"
        f"{score.rotation_deg.mean:9.3f} +-{score.rotation_deg.std:6.3f}"
    )


def closures_of(store: MapStore) -> str:
    """How many closures were tried, accepted, and right by the final poses."""
    tried = sum(c.kind in CLOSURES for c in store.constraints())
    score = score_loops(store, trajectory_of(store), None)
    return f"{tried} tried, {len(score.right)} accepted, {score.precision:.1%} right"


def print_ablation(store: MapStore, relations: Relations | None, config: Config) -> None:
    """The same log with fewer and fewer of the ingredients."""
    frames = store.tracked_frames()
    if frames.odom_from_base is not None:
        print(f"{'  odometry only':<28}{errors_of(store, frames.odom_from_base, relations)}")
    kinds: set[ConstraintKind] = {ConstraintKind.NEIGHBOUR}
    for label, kind in (
        ("  + matching", ConstraintKind.NEIGHBOUR),
        ("  + recognition", ConstraintKind.LOOP_CLOSURE),
        ("  + proximity", ConstraintKind.PROXIMITY),
    ):
        kinds.add(kind)
        poses = solved_with(store, kinds, config)
        every = pose_every_frame(store.nodes(), poses, frames)
        print(f"{label:<28}{errors_of(store, every, relations)}")
    final = store.frame_poses()
    assert final is not None
    print(f"{'  + refinement':<28}{errors_of(store, final, relations)}")


def solved_with(store: MapStore, kinds: set[ConstraintKind], config: Config) -> Poses:
    """The graph solved with the accepted constraints of some kinds only."""
    nodes = store.nodes()
    ids = np.array([node.id for node in nodes], np.int64)
    start = np.stack([node.tracked_from_base for node in nodes])
    constraints = [c for c in store.constraints() if c.kind in kinds and c.accepted]
    return solve(ids, start, constraints, True, replace(config.graph, covariances=False)).poses


if __name__ == "__main__":
    main()
