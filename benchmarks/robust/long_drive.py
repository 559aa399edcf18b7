"""A long RGB-D drive, written as a stream and built: memory and throughput from start to end."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from cli.interrupts import resident_mb
from cli.progress import StderrProgress
from formats.logs import open_log
from formats.logs.channels import Channel
from formats.logs.recorded_log import RecordedLog
from formats.recording_files import LogWriter
from formats.recording_sinks import Handle, McapSink
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world

Entry = tuple[int, Channel, bytes]
_ROUTE = "2.6,-0.5 4.6,-0.7 6.6,-0.7"
_STANDS = 2.0  # times as long as it drove, after each leg
_STATIC = ("/tf_static", "/robot_description")
_STAMP_AT = 4  # bytes of a CDR message before its header's stamp
_GAP_NS = 50_000_000  # between the end of one leg and the next


def write_drive(path: Path, gigabytes: float) -> int:
    """A log of raw colour and depth of about this size; gives the number of messages.

    One leg is rendered; it is played forwards and backwards, with a pause after each, so that the
    robot stays on its path. Only stamps are written anew, so gigabytes cost seconds.
    """
    with tempfile.TemporaryDirectory(prefix="leg-", dir=path.parent) as name:
        scene = list(_rendered(Path(name) / "leg.mcap"))
    head = [entry for entry in scene if entry[1].topic in _STATIC]
    body = [entry for entry in scene if entry[1].topic not in (*_STATIC, "/tf")]
    sink, handles = McapSink(path, "none"), dict[str, Handle]()
    count, size = 0, 0
    for time_ns, channel, data in itertools.chain(_once(head), _played(body)):
        if channel.topic not in handles:
            handles[channel.topic] = sink.add(channel)
        sink.write(handles[channel.topic], time_ns, data)
        count, size = count + 1, size + len(data)
        if size >= gigabytes * 1e9:
            break
    sink.close()
    return count


def _rendered(path: Path) -> Iterator[Entry]:
    settings = SimulationSettings()
    settings = replace(
        settings,
        camera=replace(settings.camera, compressed=False),
        laser=replace(settings.laser, enabled=False),
        imu=replace(settings.imu, enabled=False),
    )
    with LogWriter(path, compression="none") as writer:
        recording = simulate(find_world("apartment"), seed=3, route=_ROUTE, settings=settings)
        for topic, message, time_ns in recording.messages():
            writer.write(topic, message, time_ns)
    log = open_log([path])
    assert isinstance(log, RecordedLog)
    yield from ((time_ns, channel, bytes(data)) for time_ns, channel, data in log.records())


def _once(entries: Sequence[Entry]) -> Iterator[Entry]:
    """The first message of each topic."""
    seen = set[str]()
    for entry in entries:
        if entry[1].topic not in seen:
            seen.add(entry[1].topic)
            yield entry


def _played(body: list[Entry]) -> Iterator[Entry]:
    """Leg after leg without end: there, a pause, back, a pause."""
    first, last = body[0][0], body[-1][0]
    length = last - first + _GAP_NS
    start, forward = first, True
    while True:
        for time_ns, channel, data in body if forward else reversed(body):
            at = start + (time_ns - first if forward else last - time_ns)
            yield at, channel, _restamped(data, at)
        start += length
        for _ in range(int(_STANDS * length / 1e9)):
            yield from _still(body[-200:] if forward else body[199::-1], start)
            start += 1_000_000_000
        forward = not forward


def _still(end: Sequence[Entry], start: int) -> Iterator[Entry]:
    """A second in which nothing moves: the leg's last message of each topic, at its rate."""
    lasts = {channel.topic: (channel, data) for _, channel, data in end}
    for tick in range(30):
        at = start + tick * 33_000_000
        for topic, (channel, data) in sorted(lasts.items()):
            if "odom" in topic or tick % 3 == 0:
                yield at, channel, _restamped(data, at)


def _restamped(data: bytes, at: int) -> bytes:
    seconds, rest = divmod(at, 10**9)
    stamp = seconds.to_bytes(4, "little") + rest.to_bytes(4, "little")
    return data[:_STAMP_AT] + stamp + data[_STAMP_AT + 8 :]


class _Watch(StderrProgress):
    """Progress that keeps, of the pass over the log, when how much was done with which memory."""

    def update(self, done: float) -> None:
        super().update(done)
        if self._name == "track":
            _SEEN.append((done, time.process_time(), resident_mb()))


_SEEN: list[tuple[float, float, float]] = []


def inside(arguments: list[str]) -> None:
    """The process that builds: prints its course as JSON on the last line."""
    import cli.build
    from cli.main import main

    cli.build.StderrProgress = _Watch  # type: ignore[misc,attr-defined]
    sys.argv = ["mapmyworld", *arguments]
    code: object = 0
    try:
        main()
    except SystemExit as end:
        code = end.code
    with suppress(BrokenPipeError):
        print(json.dumps({"exit": code or 0, "tenths": _tenths(_SEEN)}))


def _tenths(seen: list[tuple[float, float, float]]) -> list[tuple[float, float]]:
    """Seconds of log a CPU second, and memory in MB at the end, of each tenth of the pass."""
    if not seen:
        return []
    found = []
    last = seen[-1][0]
    before = seen[0]
    for k in range(1, 11):
        now = next(entry for entry in seen if entry[0] >= last * k / 10 - 1e-9)
        rate = (now[0] - before[0]) / max(now[1] - before[1], 1e-9)
        found.append((round(rate, 2), round(now[2], 1)))
        before = now
    return found


def build_drive(path: Path, options: list[str]) -> dict[str, object]:
    """Peak memory in MB, CPU seconds, and the course of the pass over the log."""
    code = "import sys, robust.long_drive as d; d.inside(sys.argv[1:])"
    command = [sys.executable, "-c", code, "build", str(path), "--format", "json", "-q"]
    done = subprocess.run(
        [*command, "-o", str(path.with_suffix(".db")), "--overwrite", *options],
        capture_output=True, text=True, check=False, cwd=Path(__file__).parent.parent,
    )  # fmt: skip
    reported, _, course = done.stdout.strip().rpartition("\n")
    if done.returncode or json.loads(course)["exit"] not in (0, 3):
        raise SystemExit(done.stderr)
    summary = json.loads(reported)
    return {
        "gigabytes": path.stat().st_size / 1e9,
        "duration_s": summary["duration_s"],
        "nodes": summary["nodes"],
        "peak_mb": summary["peak_memory_mb"],
        "cpu_s": summary["cpu_s"],
        "tenths (log s a CPU s, MB)": json.loads(course)["tenths"],
    }
