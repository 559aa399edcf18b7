"""What a planar laser can meet: segments at its height, and rays cast against them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array
from mapmyworld.kernels.planar_rays import cast_planar_rays
from mapmyworld.simulation.world import Scene

_CELL = 0.5  # m, edge of the cells that rays walk through
_SPARE = 1e-6  # m around a piece of a segment
_TOUCH = 1e-9  # m by which vertices on the plane are lifted, so that each triangle is cut once


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Segments at one height, sorted into cells."""

    segments: Array
    """(S, 4) x0, y0, x1, y1."""
    glass: NDArray[np.bool_]
    """(S,)."""
    cell_starts: NDArray[np.int64]
    """(C + 1,) where each cell's segments begin in `cell_segments`; cells row by row."""
    cell_segments: NDArray[np.int64]
    """(K,) indices of segments."""
    corner: Array
    """(2,) m, of the first cell."""
    shape: NDArray[np.int64]
    """(2,) cells along x and y."""

    def cast(self, rays: Array) -> tuple[Array, NDArray[np.int64]]:
        """Ranges, infinite where nothing is met, and segments met (-1), (N,) both, of rays (N, 3).

        A ray is x, y, angle; in m and rad.
        """
        ranges, hits = np.empty(len(rays)), np.empty(len(rays), np.int64)
        cast_planar_rays(
            np.ascontiguousarray(rays, np.float64),
            self.segments,
            self.cell_starts,
            self.cell_segments,
            self.corner,
            _CELL,
            self.shape,
            ranges,
            hits,
        )
        return ranges, hits


def plan_at(scene: Scene, height: float) -> Plan:
    """The plan of a scene at the laser's height above the floor."""
    segments, owner = horizontal_section(scene.faces.corners, height)
    return plan_of_segments(segments, scene.glass[owner])


def plan_of_segments(segments: Array, glass: NDArray[np.bool_] | None = None) -> Plan:
    """The plan of walls (S, 4), which may be `glass` (S,), sorted into cells."""
    ends = segments.reshape(-1, 2) if len(segments) else np.zeros((1, 2))
    corner = ends.min(0) - _CELL
    shape = np.ceil((ends.max(0) + _CELL - corner) / _CELL).astype(np.int64)
    keys, owners = _cells_of(segments, corner, shape)
    starts = np.searchsorted(keys, np.arange(shape[0] * shape[1] + 1)).astype(np.int64)
    glass = np.zeros(len(segments), np.bool_) if glass is None else glass
    return Plan(np.ascontiguousarray(segments), glass, starts, owners, corner, shape)


def _cells_of(
    segments: Array, corner: Array, shape: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorted keys of cells and the segments that may lie in them.

    By pieces of half a cell, a hair's breadth to spare: the corners around one lie in its cells.
    """
    start, way = segments[:, :2], segments[:, 2:] - segments[:, :2]
    pieces = np.maximum(np.ceil(2.0 * np.hypot(*way.T) / _CELL), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(segments)), pieces)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    ends = [start[owner] + ((number + k) / pieces[owner])[:, None] * way[owner] for k in (0, 1)]
    low, high = np.minimum(*ends) - _SPARE, np.maximum(*ends) + _SPARE
    (left, bottom), (right, top) = (
        np.floor((e - corner) / _CELL).astype(int).T for e in (low, high)
    )
    keys = np.concatenate([y * shape[0] + x for x in (left, right) for y in (bottom, top)])
    table = np.unique(np.column_stack([keys, np.tile(owner, 4)]), axis=0)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1])


def horizontal_section(corners: Array, height: float) -> tuple[Array, NDArray[np.int64]]:
    """Segments (S, 4) as x0, y0, x1, y1 where triangles (T, 3, 3) cross z = height, and (S,) whose.

    All in m; corners of triangles are rows.
    """
    z = corners[:, :, 2] - height
    z = np.where(np.abs(z) < _TOUCH, _TOUCH, z)
    owner = np.flatnonzero((z.min(1) < 0.0) & (z.max(1) > 0.0))
    segments = np.zeros((len(owner), 2, 2))
    filled = np.zeros(len(owner), np.int64)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        za, zb = z[owner, a], z[owner, b]
        crosses = np.flatnonzero((za < 0.0) != (zb < 0.0))
        share = za[crosses] / (za[crosses] - zb[crosses])
        start, end = corners[owner[crosses], a, :2], corners[owner[crosses], b, :2]
        segments[crosses, filled[crosses]] = start + share[:, None] * (end - start)
        filled[crosses] += 1
    return segments.reshape(-1, 4), owner
