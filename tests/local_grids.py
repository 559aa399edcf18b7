"""A node's local grid as RTAB-Map keeps it, read from its files and from ours, to test against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from formats.database.blobs import blob_to_matrix
from formats.database.connection import Connection
from mapmyworld.errors import MapError

_CELLS = ("ground_cells", "obstacle_cells", "empty_cells")
_COLUMNS = (*_CELLS, "cell_size", "view_point_x", "view_point_y", "view_point_z")


@dataclass(frozen=True, slots=True, eq=False)
class LocalGrid:
    """What one node saw of the ground, as centres of cells in the base frame."""

    ground: NDArray[np.float32]
    """(N, 3) floor; z is 0 in a planar grid."""
    obstacle: NDArray[np.float32]
    """(N, 3) occupied."""
    empty: NDArray[np.float32]
    """(N, 3) free by a ray that passed."""
    cell_size: float  # m
    view_point: NDArray[np.float64]
    """(3,) the sensor, base frame."""


def read_local_grid(db: Connection, node_id: int) -> LocalGrid | None:
    """The local grid of a node; None where it has none. Raises `MapError` for damaged cells."""
    if not db.columns("Data") >= set(_COLUMNS):
        return None
    row = db.row(f"SELECT {', '.join(_COLUMNS)} FROM Data WHERE id = ?", (node_id,))
    if row is None or not row[3]:
        return None
    what = f"{db.path}: node {node_id}'s"
    ground, obstacle, empty = (_centres(row[i], f"{what} {_CELLS[i]}") for i in range(3))
    view = np.array([value or 0.0 for value in row[4:]], np.float64)
    return LocalGrid(ground, obstacle, empty, float(row[3]), view)


def _centres(blob: bytes | None, what: str) -> NDArray[np.float32]:
    matrix = blob_to_matrix(blob, what)
    if matrix is None:
        return np.zeros((0, 3), np.float32)
    rows, _, channels = matrix.shape
    if matrix.dtype != np.float32 or rows != 1 or not 2 <= channels <= 7:
        raise MapError(f"{what}: no cells have {rows} rows of {channels} {matrix.dtype}")
    centres = np.zeros((matrix.shape[1], 3), np.float32)
    # Two channels and five (with normals) are planar.
    used = 2 if channels in (2, 5) else 3
    centres[:, :used] = matrix[0, :, :used]
    return centres
