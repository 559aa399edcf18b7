"""What simulating costs: a minute of RGB-D, laser and odometry, and laser-only logs.

    python benchmarks/simulation.py [--seconds 60] [--worlds apartment hall]

Prints CPU seconds, wall seconds and the peak memory of this process.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from formats.recording_files import LogWriter
from mapmyworld.simulation import WORLDS, SimulationSettings, simulate


def measure(world: str, seconds: float, *, camera: bool, folder: Path) -> str:
    """Records up to `seconds` of a world's default drive; a row of the table."""
    settings = SimulationSettings()
    settings = replace(settings, camera=replace(settings.camera, enabled=camera))
    wall, processor = time.perf_counter(), time.process_time()
    recording = simulate(world, settings=settings)
    path = folder / f"{world}{'' if camera else '-laser'}.mcap"
    limit = recording.truth.start_ns + round(seconds * 1e9)
    count = 0
    with LogWriter(path) as log:
        for topic, message, log_time_ns in recording.messages():
            if log_time_ns > limit:
                break
            log.write(topic, message, log_time_ns)
            count += 1
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    recorded = min(seconds, recording.duration)
    sensors = "camera, laser" if camera else "laser"
    return (
        f"| {world} | {sensors} | {recorded:.0f} | {count} | {path.stat().st_size / 1e6:.1f} "
        f"| {wall:.1f} | {processor:.1f} | {peak:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--worlds", nargs="+", default=["apartment", "hall"], choices=list(WORLDS))
    options = parser.parse_args()
    print("| world | sensors | s recorded | messages | MB | wall s | CPU s | peak MB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for world in options.worlds:
            for camera in (False, True):
                row = measure(world, options.seconds, camera=camera, folder=Path(folder))
                print(row, flush=True)


if __name__ == "__main__":
    main()
