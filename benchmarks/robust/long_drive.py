"""A long RGB-D drive, written as a stream and built: memory and throughput from start to end."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from formats.recording import LogWriter
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import Message, TransformsMessage

_SCENE_S = 8.0  # of simulated drive that is played to and fro


def write_drive(path: Path, gigabytes: float) -> int:
    """A log of raw colour and depth of about this size; gives the number of messages.

    A short drive is rendered once and played forwards and backwards, so that the robot stays on
    its path and no image has to be rendered twice; noise in the last bits keeps frames apart.
    """
    scene = [*_scene()]
    head = [entry for entry in scene if isinstance(entry[1], TransformsMessage)]
    body = [entry for entry in scene if not isinstance(entry[1], TransformsMessage)]
    count, wanted = 0, gigabytes * 1e9
    with LogWriter(path, compression="none", overwrite=True) as writer:
        for topic, message, time_ns in head:
            writer.write(topic, message, time_ns)
        while not count % 500 or path.stat().st_size < wanted:
            for topic, message, time_ns in _played(body, count // len(body)):
                writer.write(topic, message, time_ns)
                count += 1
                if count % 500 == 0 and path.stat().st_size >= wanted:
                    return count
    return count


def _scene() -> Iterator[tuple[str, Message, int]]:
    settings = SimulationSettings()
    settings = replace(
        settings,
        camera=replace(settings.camera, compressed=False),
        laser=replace(settings.laser, enabled=False),
        imu=replace(settings.imu, enabled=False),
    )
    recording = simulate(find_world("apartment"), seed=3, route="2.6,-0.5", settings=settings)
    yield from recording.messages()


def _played(body: list[tuple[str, Message, int]], turn: int) -> Iterator[tuple[str, Message, int]]:
    """The scene once more: backwards in odd turns, with stamps that go on."""
    first, last = body[0][2], body[-1][2]
    length = last - first + 50_000_000
    for topic, message, time_ns in body if turn % 2 == 0 else reversed(body):
        place = time_ns - first if turn % 2 == 0 else last - time_ns
        late = getattr(message, "stamp_ns", time_ns) - time_ns
        late = late if turn % 2 == 0 else 0
        at = first + turn * length + place
        yield topic, replace(message, stamp_ns=at + late), at  # type: ignore[type-var]


def build_drive(path: Path, options: list[str]) -> dict[str, float]:
    """Peak memory in MB, CPU seconds, and log seconds a second over the build's course."""
    command = [sys.executable, "-m", "cli.main", "build", str(path), "--format", "json", "-q"]
    started = time.monotonic()
    done = subprocess.run(
        [*command, "-o", str(path.with_suffix(".db")), "--overwrite", *options],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode not in (0, 3):
        raise SystemExit(done.stderr)
    summary = json.loads(done.stdout)
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "gigabytes": path.stat().st_size / 1e9,
        "duration_s": summary["duration_s"],
        "nodes": summary["nodes"],
        "peak_mb": usage.ru_maxrss / 1024,
        "cpu_s": summary["cpu_s"],
        "wall_s": time.monotonic() - started,
    }
