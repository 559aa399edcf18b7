"""How fast logs are read, against merely decompressing the same chunks, and in how much memory.

    python benchmarks/reading.py [LOG...]

Without arguments, logs are made in a temporary folder from the recorded data (../shared/data or
$MAPMYWORLD_DATA): a laser log, a robot's bag, colour and depth, colour alone; as MCAP and
as ROS 1 bags.
Reading means: every message handed out, and every one that mapping uses decoded, but no pixels.
*Survey* is the first pass of a build: all of tf and odometry, a sample of the rest. Every run opens
the log anew, so that sums are checked. Times are CPU seconds, the best of five runs. Peak memory is
that of a process that reads a log of a camera and a laser once, 30 s long and four times as long.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from common import DATA

from cli.interrupts import peak_memory_mb
from formats.converting import convert_log
from formats.logs import open_log
from formats.logs.compression import decompress
from formats.logs.mcap_records import HEAD_BYTES, parse_chunk_head, record_head
from formats.logs.recorded_log import RecordedLog
from formats.logs.ros1_records import U32, field_u32, parse_fields
from formats.recording_files import LogWriter
from mapmyworld.sensing.survey import survey_log
from mapmyworld.types import ImageMessage, LaserScanMessage, MessageKind

RUNS = 5
HEADER = """\
| log | messages | MB | kB a message | decompressing, s | reading, s | us a message | ratio \
| real time | survey, s |
|---|---|---|---|---|---|---|---|---|---|"""


def cpu_seconds(work: Callable[[], int]) -> tuple[float, int]:
    """The best of several runs, and what the last one gave."""
    best, given = float("inf"), 0
    for _ in range(RUNS):
        start = time.process_time()
        given = work()
        best = min(best, time.process_time() - start)
    return best, given


def decompress_all(log: RecordedLog) -> int:
    """Bytes of all chunks, read and decompressed, and nothing else."""
    total = 0
    with log.path.open("rb") as stream:
        for block in log.index().blocks:
            stream.seek(block.offset)
            if log.name == "MCAP":
                content = stream.read(record_head(stream.read(HEAD_BYTES))[1])
                head = parse_chunk_head(content[:128])
                stored = content[head.data_at :]
                total += len(decompress(stored, head.compression, head.size))
            else:
                fields = parse_fields(stream.read(U32(stream.read(4))[0]))
                stored = stream.read(U32(stream.read(4))[0])
                size = field_u32(fields, b"size")
                total += len(decompress(stored, fields[b"compression"].decode(), size))
    return total


def opened(path: Path) -> RecordedLog:
    """The log as on the first day: nothing of it is known or checked."""
    log = open_log([path])
    assert isinstance(log, RecordedLog)
    return log


def read_all(log: RecordedLog) -> int:
    """Messages, each decoded that has a meaning."""
    count = 0
    for message in log.messages():
        if message.kind is not MessageKind.OTHER:
            message.decode()
        count += 1
    return count


def compare(path: Path) -> str:
    log = opened(path)
    read_all(log)
    bare, size = cpu_seconds(lambda: decompress_all(log))
    full, count = cpu_seconds(lambda: read_all(opened(path)))
    survey, _ = cpu_seconds(lambda: len(survey_log(opened(path)).streams))
    real_time = log.info().duration_s / full
    return (
        f"| {path.name} | {count} | {size / 1e6:.1f} | {size / count / 1e3:.1f} | {bare:.3f} | "
        f"{full:.3f} | {full / count * 1e6:.1f} | {bare / full:.0%} | {real_time:.0f}x | "
        f"{survey:.3f} |"
    )


def make_logs(folder: Path) -> list[Path]:
    """Recorded data as bags."""
    camera = DATA / "rgbd" / "freiburg1_rpy_15hz"
    colour = frozenset({"/camera/rgb/image_color", "/camera/rgb/camera_info"})
    jobs = [
        (DATA / "laser" / "intel.clf.bz2", "intel.mcap", None, None),
        (DATA / "laser" / "intel.clf.bz2", "intel-lz4.bag", "lz4", None),
        (DATA / "laser" / "intel.clf.bz2", "intel-bz2.bag", "bz2", None),
        (DATA / "bags" / "neato_middle.bag", "neato.mcap", None, None),
        (camera, "colour-depth.mcap", None, None),
        (camera, "colour-depth-lz4.bag", "lz4", None),
        (camera, "colour.mcap", None, colour),
    ]
    for source, name, compression, topics in jobs:
        convert_log(open_log([source]), folder / name, topics=topics, compression=compression)
    recorded = [DATA / "bags" / "neato_with_particle_filter.bag"]  # bz2, as it was recorded
    return recorded + [folder / name for _, name, _, _ in jobs]


def write_long_log(path: Path, seconds: int) -> None:
    """A camera at 10 Hz, raw colour and depth that do not compress well, and a laser at 20 Hz."""
    noise = np.random.default_rng(0)
    rgb = noise.integers(0, 256, (480, 640, 3), np.uint8)
    depth = noise.uniform(0.5, 4.0, (480, 640)).astype(np.float32)
    ranges = noise.uniform(0.5, 9.0, 720).astype(np.float32)
    with LogWriter(path, compression="lz4") as writer:
        for tick in range(seconds * 20):
            t = tick * 50_000_000
            scan = LaserScanMessage(t, "l", -3.1, 0.009, 0, 0.05, 0.1, 10.0, ranges, ranges)
            writer.write("/scan", scan, t)
            if tick % 2 == 0:
                colour = ImageMessage(t, "c", "rgb8", 640, 480, lambda: rgb)
                writer.write("/rgb", colour, t)
                writer.write("/depth", ImageMessage(t, "c", "16UC1", 640, 480, lambda: depth), t)


def report_memory(path: Path) -> None:
    """In a process of its own: prints the peak before and after reading."""
    before = peak_memory_mb()
    log = opened(path)
    count = read_all(log)
    print(f"| {log.info().duration_s:.0f} s | {path.stat().st_size / 1e6:.0f} MB | {count} "
          f"| {before:.0f} | {peak_memory_mb():.0f} |")  # fmt: skip


def memory_table(folder: Path) -> None:
    print("\n| length | file | messages | peak before reading, MB | peak after, MB |")
    print("|---|---|---|---|---|", flush=True)
    for seconds in (30, 120):
        path = folder / f"long-{seconds}.mcap"
        write_long_log(path, seconds)
        subprocess.run([sys.executable, __file__, "--memory", str(path)], check=True)
        path.unlink()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--memory", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.memory:
        report_memory(arguments.memory)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = arguments.logs or make_logs(folder)
        print(HEADER)
        for path in logs:
            print(compare(path), flush=True)
        if not arguments.logs:
            memory_table(folder)


if __name__ == "__main__":
    main()
