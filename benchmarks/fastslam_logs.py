"""Grid-based FastSLAM on recorded and simulated logs: accuracy, time, memory, seeds.

    python benchmarks/fastslam_logs.py intel fr079              # relations metric (needs the data)
    python benchmarks/fastslam_logs.py apartment hall office    # simulated, absolute error
    python benchmarks/fastslam_logs.py intel --seeds 5
    python benchmarks/fastslam_logs.py intel --particles 10 30 100 200
    python benchmarks/fastslam_logs.py apartment --world-seed 5   # another drive

Each run is a process of its own, so that time and peak memory are its own.
"""

from __future__ import annotations

import argparse
import bz2
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import DATA
from numpy.typing import NDArray

from mapmyworld.types import Trajectory
from mapmyworld.types.maps import Relations

RECORDED = ("intel", "fr079", "mit-csail")
ACROSS = 15.0  # m of path between the moments of a relation from which it spans a loop
MISSED = 0.5  # m by which a relation is off that spans a loop which was not closed


def log_of(name: str, folder: Path, world_seed: int) -> tuple[Path, Path | None]:
    """The log's file in `folder`, and its relations or its true path."""
    if name in RECORDED:
        source = DATA / "laser" / f"{name}.clf.bz2"
        if not source.exists():
            sys.exit(f"{source}: not found; set MAPMYWORLD_DATA to the folder of recorded data")
        path = folder / f"{name}.clf"
        with bz2.open(source) as packed, path.open("wb") as plain:
            shutil.copyfileobj(packed, plain)
        relations = source.with_name(f"{name}.relations")
        return path, relations if relations.exists() else None
    return simulated(name, folder, world_seed)


def simulated(world: str, folder: Path, seed: int) -> tuple[Path, Path]:
    """A drive with laser and wheels only, and its true path."""
    from formats.recording_files import LogWriter
    from formats.trajectory_files import write_trajectory
    from mapmyworld.simulation import SimulationSettings, simulate

    settings = SimulationSettings()
    settings = replace(settings, camera=replace(settings.camera, enabled=False))
    recording = simulate(world, seed=seed, settings=settings)
    path, truth = folder / f"{world}.mcap", folder / f"{world}_truth.tum"
    with LogWriter(path, overwrite=True) as writer:
        for topic, message, log_time_ns in recording.messages():
            writer.write(topic, message, log_time_ns)
    write_trajectory(truth, recording.truth.trajectory, "tum")
    return path, truth


def run_once(log: Path, reference: Path | None, particles: int, seed: int, threads: int) -> dict:
    """Figures of one run in this process."""
    from formats.logs import open_log
    from mapmyworld.api import Silent
    from mapmyworld.config import Config, ParticlesConfig
    from mapmyworld.particles.fastslam import run_fastslam
    from mapmyworld.sensing import make_plan, read_frames, survey_log
    from mapmyworld.stages.first_pass import deskewed, wheels_of_log

    settings = ParticlesConfig(count=particles, count_min=min(10, particles))
    config = Config(particles=settings, seed=seed, threads=threads)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    cpu, wall = time.process_time(), time.monotonic()
    source = open_log([log])
    plan = deskewed(source, make_plan(survey_log(source), config.sensing), config, Silent())
    wheels = wheels_of_log(source, plan, config, Silent())
    result = run_fastslam(read_frames(source, plan, config.sensing), config, Silent(), wheels)
    return {
        "log": log.stem,
        "particles": particles,
        "seed": seed,
        **scores(result, reference),
        "cpu_s": time.process_time() - cpu,
        "wall_s": time.monotonic() - wall,
        "log_s": float(result.stamps_ns.max() - result.stamps_ns.min()) * 1e-9,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "start_mb": before,
    }


def scores(result: object, reference: Path | None) -> dict[str, float]:
    """The relations metric, or ATE, of a result."""
    from formats.relation_files import read_relations
    from formats.trajectory_files import read_trajectory
    from mapmyworld.evaluation import ate, relations_score
    from mapmyworld.geometry.planar import planar_to_matrix
    from mapmyworld.types import Trajectory

    path = Trajectory(result.stamps_ns, planar_to_matrix(result.path))  # type: ignore[attr-defined]
    if reference is None:
        return {}
    if reference.suffix == ".relations":
        relations = read_relations(reference)
        score = relations_score(path, relations)
        worst = float(score.translation_errors.max())
        errors = score.translation_errors[spans_loop(path, relations)[score.covered]]
        return {
            "across": len(errors),
            "missed": int((errors > MISSED).sum()),
            "worst_across_m": float(errors.max(initial=0.0)),
            "error_m": score.translation.mean,
            "std_m": score.translation.std,
            "error_deg": score.rotation_deg.mean,
            "worst_m": worst,
        }
    found = ate(path, read_trajectory(reference))
    return {"error_m": found.translation.rmse, "worst_m": found.translation.maximum}


def spans_loop(path: Trajectory, relations: Relations) -> NDArray[np.bool_]:
    """(N,) whether the robot drove a loop between the two moments of a relation."""
    order = np.argsort(path.stamps_ns, kind="stable")
    steps = np.linalg.norm(np.diff(path.poses[:, :3, 3], axis=0), axis=1)
    driven = np.concatenate([[0.0], np.cumsum(steps)])[order]
    at = np.searchsorted(path.stamps_ns[order], relations.stamps_ns)
    ends = driven[np.minimum(at, len(driven) - 1)]
    return np.abs(ends[:, 1] - ends[:, 0]) > ACROSS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "logs", nargs="*", default=["intel", "fr079", "apartment", "hall", "office"]
    )
    parser.add_argument("--particles", type=int, nargs="+", default=[30])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--world-seed", type=int, default=0)
    parser.add_argument("--child", nargs=5, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        log, reference, particles, seed, threads = arguments.child
        found = run_once(
            Path(log),
            Path(reference) if reference else None,
            int(particles),
            int(seed),
            int(threads),
        )
        print(json.dumps(found))
        return
    print(
        "log        particles seed  error m (std)      deg    worst m"
        "  loops missed/spanned (worst m)  CPU s  x real  MB"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.logs:
            log, reference = log_of(name, Path(folder), arguments.world_seed)
            for particles in arguments.particles:
                for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
                    values = (log, reference or "", particles, seed, arguments.threads)
                    print_row(child(*values))


def child(*values: object) -> dict:
    """Figures of one run in a process of its own, by the arguments of `run_once`."""
    command = [sys.executable, __file__, "--child", *(str(value) for value in values)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def print_row(r: dict) -> None:
    real = r["log_s"] / r["wall_s"]
    print(
        f"{r['log']:<10} {r['particles']:>9} {r['seed']:>4}  "
        f"{r.get('error_m', float('nan')):.4f} ({r.get('std_m', float('nan')):.4f})  "
        f"{r.get('error_deg', float('nan')):>6.3f}  {r.get('worst_m', float('nan')):>7.3f}  "
        f"{r.get('missed', 0):>7}/{r.get('across', 0)} ({r.get('worst_across_m', 0.0):.3f})"
        f"{r['cpu_s']:>5.1f}  {real:>6.1f}  {r['peak_mb']:>4.0f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
