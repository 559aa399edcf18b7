"""Points and colours out of the packed records of a point cloud message."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from formats.logs.message_fields import singles

# sensor_msgs/PointField datatypes.
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def cloud_points(
    cells: NDArray[np.void],
) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Finite points (N, 3) of a cloud's `cells` (M,), and their RGB (N, 3) or None."""
    if not {"x", "y", "z"} <= set(cells.dtype.names or ()):
        raise ValueError("a point cloud without x, y and z")
    points = np.stack([singles(cells[axis]) for axis in "xyz"], axis=-1)
    finite = np.isfinite(points).all(axis=-1)
    colours = _colours(cells)
    return points[finite], None if colours is None else colours[finite]


def cloud_cells(
    fields: Iterable[tuple[str, int, int]],
    data: bytes | memoryview,
    width: int,
    height: int,
    step: int,
    row_step: int,
    big_endian: bool = False,
) -> NDArray[np.void]:
    """One structured value a point (N,); ValueError where the fields do not fit the data.

    `fields`: name, bytes from the start of a point, datatype.
    """
    order = ">" if big_endian else "<"
    known = {name: (at, DATATYPES[kind]) for name, at, kind in fields if kind in DATATYPES}
    layout = np.dtype(
        {
            "names": list(known),
            "formats": [order + kind for _, kind in known.values()],
            "offsets": [at for at, _ in known.values()],
            "itemsize": step,
        }
    )
    row_bytes = width * step
    if row_step in {0, row_bytes} or height == 1:
        return np.frombuffer(data, layout, width * height)
    if row_step < row_bytes or row_step * height > len(data):
        raise ValueError("the rows of a point cloud do not fit its data")
    rows = np.frombuffer(data, np.uint8, row_step * height).reshape(height, row_step)
    return np.ascontiguousarray(rows[:, :row_bytes]).view(layout).reshape(-1)


def _colours(cells: NDArray[np.void]) -> NDArray[np.uint8] | None:
    """RGB (N, 3) of a packed `rgb`/`rgba` field or of `red`, `green`, `blue`."""
    names = cells.dtype.names or ()
    for name in ("rgb", "rgba"):
        if name in names and cells[name].dtype.itemsize == 4:
            packed = np.ascontiguousarray(cells[name]).view(cells[name].dtype.str[0] + "u4")
            return np.stack([(packed >> shift) & 255 for shift in (16, 8, 0)], axis=-1).astype(
                np.uint8
            )
    for trio in (("red", "green", "blue"), ("r", "g", "b")):
        if set(trio) <= set(names):
            scale = 255.0 if cells[trio[0]].dtype.kind == "f" else 1.0
            return np.stack([cells[name] * scale for name in trio], axis=-1).astype(np.uint8)
    return None
