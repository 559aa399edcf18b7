"""The truth beside a simulated log: `<log>.truth/` with plain files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.cloud_files import write_mesh
from formats.decimal_stamps import nanoseconds_from_integer
from formats.grid_files import write_grid
from formats.trajectory_files import write_trajectory
from formats.whole_files import read_whole, write_whole
from mapmyworld.errors import MapError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.types import Mesh, OccupancyGrid, Trajectory
from mapmyworld.types.maps import Relations

_PAIR_COLUMNS = ["first_stamp_ns", "second_stamp_ns", "x", "y", "yaw"]


def truth_folder(log: Path) -> Path:
    """Where the truth of a log lies."""
    return log.with_name(log.name + ".truth")


def write_truth(
    folder: Path,
    *,
    trajectory: Trajectory,
    grid: OccupancyGrid,
    mesh: Mesh,
    loops: Relations,
    calibration: Mapping[str, Any],
) -> None:
    """Writes all of it; `MapError` where the folder cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_trajectory(folder / "trajectory.tum", trajectory, "tum")
        write_grid(folder / "grid", grid)
        write_mesh(folder / "mesh.ply", mesh)
        pairs = [",".join(_PAIR_COLUMNS)]
        poses = matrix_to_planar(loops.first_from_second).tolist()
        for (first, second), (x, y, yaw) in zip(loops.stamps_ns.tolist(), poses, strict=True):
            pairs.append(f"{first},{second},{x:.6f},{y:.6f},{yaw:.6f}")
        write_whole(folder / "loop_pairs.csv", "\n".join(pairs) + "\n")
        write_whole(folder / "calibration.json", json.dumps(calibration, indent=2) + "\n")
    except OSError as error:
        raise MapError(f"{folder}: cannot be written: {error.strerror or error}") from None


def read_loop_pairs(path: Path) -> NDArray[np.int64]:
    """Stamps (P, 2) of loop_pairs.csv; `MapError` names a line that is wrong."""
    stamps = []
    lines = read_whole(path).decode("ascii", "replace").splitlines()
    for number, line in enumerate(lines[1:], start=2):
        fields = line.split(",")
        try:
            first, second, x, y, yaw = fields
            stamps.append((nanoseconds_from_integer(first), nanoseconds_from_integer(second)))
            if not (np.abs([float(x), float(y), float(yaw)]) <= FARTHEST).all():
                raise ValueError
        except ValueError:
            expected = ",".join(_PAIR_COLUMNS)
            raise MapError(f"{path}, line {number}: expected {expected}") from None
    return np.array(stamps, np.int64).reshape(-1, 2)
