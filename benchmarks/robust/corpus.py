"""Small sound files of every kind the program reads, made from one simulated drive."""

from __future__ import annotations

import bz2
import gzip
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from click.testing import CliRunner
from mcap.writer import CompressionType, Writer

from cli.main import group
from formats.logs import open_log
from formats.recording_files import LogWriter
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import LaserScanMessage, Message, OdometryMessage

Entry = tuple[str, Message, int]
ROUTE = "1.2,-0.3 turn:60"
_CHUNK_BYTES = 8192


def make_logs(folder: Path) -> list[Path]:
    """One log of each kind in a folder: files, and folders of files."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = list(drive_entries())
    laser = [entry for entry in entries if "camera" not in entry[0] and "imu" not in entry[0]]
    found = [_written(folder / "whole.mcap", entries, "zstd")]
    for name, compression in (("lz4.mcap", "lz4"), ("plain.mcap", "none"), ("plain.db3", "none")):
        found.append(_written(folder / name, laser, compression))
    for name, compression in (("whole.bag", "none"), ("bz2.bag", "bz2"), ("lz4.bag", "lz4")):
        found.append(
            _written(folder / name, entries if compression == "none" else laser, compression)
        )
    found.append(_written(folder / "recording", laser, "none"))
    found.append(_unchecked(folder / "unchecked.mcap", folder / "whole.mcap", chunked=True))
    found.append(_unchecked(folder / "bare.mcap", folder / "whole.mcap", chunked=False))
    found.append(_foxglove(folder / "json.mcap", laser))
    text = _carmen(laser).encode()
    for name, data in (
        ("a.log", text),
        ("a.log.gz", gzip.compress(text)),
        ("a.clf.bz2", bz2.compress(text)),
    ):
        (folder / name).write_bytes(data)
        found.append(folder / name)
    found.append(_tum(folder / "tum"))
    return found


def make_maps(folder: Path, log: Path) -> list[Path]:
    """Maps of a log by both methods, and by the laser and the camera alone."""
    folder.mkdir(parents=True, exist_ok=True)
    ways = {
        "whole": (),
        "particles": ("--method", "fastslam"),
        "laser": ("--set", "sensing.use_images=false"),
        "camera": ("--set", "sensing.use_scans=false"),
    }  # fmt: skip
    for name, options in ways.items():
        arguments = ["build", str(log), "-o", str(folder / f"{name}.db"), "-q", *options]
        result = CliRunner().invoke(group, arguments)
        assert result.exit_code in (0, 3), (name, result.output, result.exception)
    return [folder / f"{name}.db" for name in ways]


def make_graphs(folder: Path) -> list[Path]:
    """Pose graphs in g2o's, TORO's and GTSAM's text, with what such files hold beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(3)
    planar, spatial, toro = [], [], []
    for i in range(12):
        x, y, turn = np.cos(i / 2), np.sin(i / 2), i / 2
        planar.append(f"VERTEX_SE2 {i} {x:.6f} {y:.6f} {turn:.6f}")
        sine, cosine = np.sin(turn / 2), np.cos(turn / 2)
        spatial.append(f"VERTEX_SE3:QUAT {i} {x:.6f} {y:.6f} 0 0 0 {sine:.6f} {cosine:.6f}")
        toro.append(f"VERTEX2 {i} {x:.6f} {y:.6f} {turn:.6f}")
    for i in range(16):
        a, b = (i, i + 1) if i < 11 else sorted(rng.choice(12, 2, replace=False))
        planar.append(f"EDGE_SE2 {a} {b} 0.25 0.43 0.5 100 0 0 100 0 400")
        upper = " ".join("100" if k in (0, 6, 11, 15, 18, 20) else "0" for k in range(21))
        spatial.append(f"EDGE_SE3:QUAT {a} {b} 0.25 0.43 0 0 0 0.247 0.969 {upper}")
        toro.append(f"EDGE2 {a} {b} 0.25 0.43 0.5 100 0 100 400 0 0")
    planar += ["FIX 0", "VERTEX_XY 40 1 2", "EDGE_SE2_XY 3 40 1 0.5 100 0 100"]
    files = {"flat.g2o": planar, "space.g2o": spatial, "old.graph": toro}
    for name, lines in files.items():
        (folder / name).write_text("\n".join(lines) + "\n")
    return [folder / name for name in files]


def make_grids(folder: Path) -> list[Path]:
    """Grids as map_server's YAML with a picture beside it; each in a folder of its own."""
    cells = np.full((30, 40), 254, np.uint8)
    cells[[0, -1]], cells[:, [0, -1]], cells[10:14, 10:20] = 0, 0, 205
    found = []
    for mode, picture in (("trinary", "map.pgm"), ("scale", "map.png")):
        place = folder / mode
        place.mkdir(parents=True, exist_ok=True)
        (place / "map.yaml").write_text(
            f"image: {picture}\nmode: {mode}\nresolution: 0.05\norigin: [-1.0, -0.5, 0.0]\n"
            "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
        )
        if picture.endswith("pgm"):
            (place / picture).write_bytes(b"P5\n# a grid\n40 30\n255\n" + cells.tobytes())
        else:
            (place / picture).write_bytes(cv2.imencode(".png", cells)[1].tobytes())
        found.append(place)
    return found


def drive_entries() -> Iterator[Entry]:
    """A short drive with laser, camera, odometry and inertial unit, all of low resolution."""
    settings = SimulationSettings()
    settings = replace(
        settings,
        camera=replace(settings.camera, width=64, height=48, rate=3.0),
        laser=replace(settings.laser, beams=91, rate=5.0),
        odometry=replace(settings.odometry, rate=10.0),
        imu=replace(settings.imu, rate=20.0),
        driver=replace(settings.driver, pause=0.2),
    )
    yield from simulate(find_world("apartment"), seed=1, route=ROUTE, settings=settings).messages()


def _written(path: Path, entries: list[Entry], compression: str) -> Path:
    """The log in chunks small enough that damage to one leaves others."""
    with LogWriter(path, compression=compression, overwrite=True) as writer:
        inner = getattr(writer.sink, "_writer", None)
        for name in ("chunk_threshold", "_Writer__chunk_size", "chunk_size"):
            if hasattr(inner, name):
                setattr(inner, name, _CHUNK_BYTES)
        for topic, message, time in entries:
            writer.write(topic, message, time)
    return path


def _unchecked(path: Path, source: Path, *, chunked: bool) -> Path:
    """The log with no checksum anywhere, so that wrong bytes reach the decoders."""
    log = open_log([source])
    with path.open("wb") as stream:
        writer = Writer(
            stream, 1 << 16, CompressionType.NONE, use_chunking=chunked,
            enable_crcs=False, enable_data_crcs=False,
        )  # fmt: skip
        writer.start("ros2", "corpus")
        channels: dict[object, int] = {}
        for time, channel, data in log.records():  # type: ignore[attr-defined]
            if channel not in channels:
                schema = writer.register_schema(
                    channel.type_name, channel.schema_encoding, channel.schema
                )
                channels[channel] = writer.register_channel(channel.topic, channel.encoding, schema)
            writer.add_message(channels[channel], time, data, time)
        writer.finish()
    return path


def _foxglove(path: Path, entries: list[Entry]) -> Path:
    """Laser and odometry as Foxglove's JSON messages, without checksums."""
    with path.open("wb") as stream:
        writer = Writer(stream, 1 << 14, CompressionType.NONE, enable_crcs=False)
        writer.start("", "corpus")
        channels = {}
        for kind in ("LaserScan", "FrameTransform"):
            schema = writer.register_schema(f"foxglove.{kind}", "jsonschema", b'{"type": "object"}')
            channels[kind] = writer.register_channel(f"/{kind.lower()}", "json", schema)
        for _, message, time in entries:
            reported = _as_json(message, time)
            if reported is not None:
                writer.add_message(
                    channels[reported[0]], time, json.dumps(reported[1]).encode(), time
                )
        writer.finish()
    return path


def _as_json(message: Message, time: int) -> tuple[str, dict[str, object]] | None:
    stamp = dict(zip(("sec", "nsec"), divmod(time, 10**9), strict=True))
    if isinstance(message, LaserScanMessage):
        end = message.angle_min + message.angle_increment * (len(message.ranges) - 1)
        ranges = [float(r) if np.isfinite(r) else 0.0 for r in message.ranges]
        return "LaserScan", {
            "timestamp": stamp, "frame_id": "laser", "start_angle": message.angle_min,
            "end_angle": end, "ranges": ranges, "intensities": [],
            "pose": {
                "position": dict.fromkeys("xyz", 0.0),
                "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
            },
        }  # fmt: skip
    if isinstance(message, OdometryMessage):
        x, y, turn = matrix_to_planar(message.pose)
        return "FrameTransform", {
            "timestamp": stamp, "parent_frame_id": "odom", "child_frame_id": "laser",
            "translation": {"x": x, "y": y, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": np.sin(turn / 2), "w": np.cos(turn / 2)},
        }  # fmt: skip
    return None


def _carmen(entries: list[Entry]) -> str:
    lines = ["# CARMEN Logfile", "PARAM robot_frontlaser_offset 0.1 0 host 0"]
    pose = np.zeros(3)
    for _, message, time in entries:
        seconds = (time - entries[0][2]) * 1e-9
        if isinstance(message, OdometryMessage):
            pose = matrix_to_planar(message.pose)
            reported = " ".join(f"{v:.4f}" for v in pose)
            lines.append(f"ODOM {reported} 0.2 0.1 0 {seconds:.4f} host {seconds:.4f}")
        elif isinstance(message, LaserScanMessage):
            reported = " ".join(f"{v:.4f}" for v in pose)
            ranges = " ".join(f"{min(float(r), 80.0):.2f}" for r in message.ranges)
            count = len(message.ranges)
            lines.append(
                f"FLASER {count} {ranges} {reported} {reported} {seconds:.4f} host {seconds:.4f}"
            )
            lines.append(
                f"ROBOTLASER1 0 -1.57 3.14 0.034 30 0.01 0 {count} {ranges} 0 {reported} "
                f"{reported} "
                f"0.2 0.1 0.3 0.3 0.5 {seconds:.4f} host {seconds:.4f}"
            )
    return "\n".join(lines) + "\n"


def _tum(folder: Path) -> Path:
    """A few pictures of noise with depth and truth, as the TUM benchmark lays them out."""
    shutil.rmtree(folder, ignore_errors=True)
    rng = np.random.default_rng(5)
    lists = {"rgb": ["# colour"], "depth": ["# depth"]}
    truth = ["# truth"]
    for i in range(6):
        colour = rng.integers(0, 256, (48, 64, 3), np.uint8)
        depth = rng.integers(4000, 9000, (48, 64), np.uint16)
        for kind, picture in (("rgb", colour), ("depth", depth)):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            (folder / kind / f"{i}.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
            lists[kind].append(f"{100 + 0.1 * i:.6f} {kind}/{i}.png")
        truth.append(f"{100 + 0.1 * i:.6f} {0.1 * i} 0 0 0 0 0 1")
    for name, lines in (*lists.items(), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return folder
