"""A folder with everything that the pages' commands name: short logs, maps, truths, settings."""

from __future__ import annotations

import bz2
import shlex
import shutil
from pathlib import Path

import numpy as np
from conftest import ROOT
from docs_commands import run
from glb import write_glb
from room_drive import drive

LOGS = ROOT / "sample_logs"
SECONDS = 10  # of the sample log that the pages' own logs hold
SPHERE = """VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0 0 0 0 1
VERTEX_SE3:QUAT 2 1 1 0 0 0 0.1 0.995
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {w}
EDGE_SE3:QUAT 1 2 0 1 0 0 0 0.1 0.995 {w}
EDGE_SE3:QUAT 0 2 1 1 0 0 0 0.1 0.995 {w}
"""
EDITS = '[[pin]]\nnode = 1\nreason = "the dock"\n'
BATCH = '[[log]]\nlog = "drive.bag"\n'


def lay(folder: Path, apartment: Path) -> None:
    """Makes the folder's files; `apartment` is the finished map of the sample log."""
    (folder / "sample_logs").symlink_to(LOGS)
    whole = LOGS / "apartment.mcap"
    half = SECONDS // 2
    _converted(whole, folder / "log.mcap", 0, SECONDS)
    _converted(whole, folder / "drive.bag", 0, SECONDS)
    for k in (0, 1):
        _converted(whole, folder / f"drive_{k}.bag", k * half, half)
        drive(10).write(folder / f"part_{k}.bag")
    for name in ("drive.mcap", "next.mcap"):
        (folder / name).symlink_to("log.mcap")
    for name in ("tuesday.bag", "wednesday.bag"):
        (folder / name).symlink_to("drive.bag")
    for name in ("drive.clf.bz2", "intel.clf.bz2"):
        (folder / name).write_bytes(bz2.compress(carmen().encode()))
    (folder / "log.mcap.truth").symlink_to(f"{whole}.truth")
    shutil.copy(whole.parent / "apartment.mcap.truth" / "trajectory.tum", folder / "truth.tum")
    _relations(folder)
    shutil.copy(apartment, folder / "apartment.db")
    shutil.copy(apartment.with_suffix(".timing.json"), folder / "apartment.timing.json")
    _maps(folder)
    (folder / "sphere.g2o").write_text(SPHERE.format(w=_upper_triangle(6)))
    (folder / "edits.toml").write_text(EDITS)
    (folder / "logs.toml").write_text(BATCH)
    glb_room(folder / "house.glb")
    (folder / "maps").mkdir()
    (folder / "recordings").mkdir()
    (folder / "recordings" / "apartment.mcap").symlink_to(LOGS / "apartment.mcap")


def _converted(log: Path, made: Path, start: float, duration: float) -> None:
    words = ["convert", log, "-o", made, "--start", start, "--duration", duration, "-q"]
    assert run(shlex.join(["mapmyworld", *map(str, words)]))[0] == 0


def _maps(folder: Path) -> None:
    """Maps of the drive under the names that the pages give theirs."""
    words = ["build", folder / "drive.mcap", "-o", folder / "map.db", "-q"]
    assert run(shlex.join(["mapmyworld", *map(str, words)]))[0] in {0, 3}
    for name in ("monday", "tuesday", "last_week", "graph", "particles", "rtabmap"):
        shutil.copy(folder / "map.db", folder / f"{name}.db")
    for suffix in ("yaml", "pgm"):
        text = (folder / f"map.{suffix}").read_bytes().replace(b"map.pgm", b"building.pgm")
        (folder / f"building.{suffix}").write_bytes(text)
    words = ["export", "graph", folder / "map.db", "-o", folder / "manhattan.g2o"]
    assert run(shlex.join(["mapmyworld", *map(str, words)]))[0] == 0


def _relations(folder: Path) -> None:
    """Two moments of the drive, a second apart."""
    first = float((folder / "truth.tum").read_text().splitlines()[1].split()[0])
    line = f"{first + 2:.6f} {first + 3:.6f} 0.5 0 0 0 0 0\n"
    (folder / "intel.relations").write_text(line)


def _upper_triangle(size: int) -> str:
    return " ".join("1" if i == j else "0" for i in range(size) for j in range(i, size))


def carmen() -> str:
    """Two seconds of a robot that stands in a round room."""
    ranges = " ".join(["3.00"] * 180)
    lines = [f"FLASER 180 {ranges} 0 0 0 0 0 0 {k / 10:.6f} host {k / 10:.6f}" for k in range(20)]
    return "\n".join(lines) + "\n"


def glb_room(path: Path) -> None:
    """A floor of 7 x 6 m with walls, as binary glTF 2.0: y up, as its standard says."""
    corners = np.array([[-2, -2], [5, -2], [5, 4], [-2, 4]], np.float32)
    low = np.column_stack([corners, np.zeros(4, np.float32)])
    points = np.concatenate([low, low + np.array([0, 0, 2], np.float32)])
    faces = [(0, 1, 2), (0, 2, 3)]
    for k in range(4):
        n = (k + 1) % 4
        faces += [(k, n + 4, n), (k, k + 4, n + 4), (k, n, n + 4), (k, n + 4, k + 4)]
    triangles = np.array(faces, np.uint16)
    y_up = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
    parts = [y_up.tobytes(), triangles.tobytes() + b"\0" * (-triangles.nbytes % 4)]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": sum(map(len, parts))}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(parts[0])},
            {"buffer": 0, "byteOffset": len(parts[0]), "byteLength": len(parts[1])},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3",
             "min": y_up.min(axis=0).tolist(), "max": y_up.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5123, "count": triangles.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    write_glb(path, document, parts)
