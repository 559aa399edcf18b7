"""The map from above as SVG: grid, path, constraints; and curves over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.report.page import data_uri
from mapmyworld.errors import MapError
from mapmyworld.types import OccupancyGrid

_SCALE_BARS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)  # m
_WIDTH, _HEIGHT = 960.0, 720.0  # pixels that a picture fills at most
_POINTS = 4000  # of a path that are drawn
Place = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Straight lines of one colour between pairs of places."""

    name: str
    colour: str
    ends: NDArray[np.float64]
    """(L, 2, 2) metres, map frame."""


def map_picture(
    path: NDArray[np.float64], grid: OccupancyGrid | None, lines: Sequence[Lines]
) -> str:
    """SVG of the path (N, 2) over the grid, y upwards, with a scale bar."""
    low, high = _extent(path, grid)
    scale = min(_WIDTH / (high[0] - low[0]), _HEIGHT / (high[1] - low[1]))
    width, height = scale * (high - low)

    def place(points: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = (points - low) * scale
        return np.stack([moved[..., 0], height - moved[..., 1]], axis=-1)

    parts = [] if grid is None else [_grid_image(grid, place, scale)]
    parts += [_lines(kind, place) for kind in lines if len(kind.ends)]
    if len(path):
        parts.append(_path(place(path[:: max(1, len(path) // _POINTS)])))
        parts.append(_dot(place(path[:1])[0], "#0a0", "start"))
        parts.append(_dot(place(path[-1:])[0], "#c00", "end"))
    parts.append(_scale_bar(scale, width, height))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.1f} {height:.1f}"'
        f' width="{width:.0f}" height="{height:.0f}">{"".join(parts)}</svg>'
    )


def _extent(
    path: NDArray[np.float64], grid: OccupancyGrid | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of what is shown: the path, and the cells that were seen."""
    corners = [path] if len(path) else []
    if grid is not None:
        rows, cols = np.nonzero(np.isfinite(grid.log_odds))
        if len(rows):
            seen = np.array([[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]])
            corners.append(grid.origin + seen * grid.resolution)
    if not corners:
        return np.zeros(2), np.ones(2)
    points = np.concatenate(corners)
    margin = 0.03 * float(np.ptp(points, axis=0).max()) + 0.1
    return points.min(axis=0) - margin, points.max(axis=0) + margin


def _grid_image(grid: OccupancyGrid, place: Place, scale: float) -> str:
    cells = grid.trinary()
    grey = np.full(cells.shape, 235, np.uint8)
    grey[cells == 0], grey[cells == 100] = 255, 30
    done, data = cv2.imencode(".png", np.ascontiguousarray(grey[::-1]))
    if not done:
        raise MapError("the grid cannot be drawn")
    top_left = grid.origin + np.array([0.0, cells.shape[0] * grid.resolution])
    x, y = place(top_left)
    width, height = (side * grid.resolution * scale for side in cells.shape[::-1])
    return (
        f'<image x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}"'
        f' preserveAspectRatio="none" style="image-rendering:pixelated"'
        f' href="{data_uri(bytes(data))}"/>'
    )


def _lines(kind: Lines, place: Place) -> str:
    ends = place(kind.ends).reshape(-1, 4)
    path = "".join(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" for x0, y0, x1, y1 in ends)
    return f'<path d="{path}" stroke="{kind.colour}" stroke-width="1" stroke-opacity=".6"/>'


def _path(points: NDArray[np.float64]) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="#1666b0" stroke-width="1.2"/>'


def _dot(at: NDArray[np.float64], colour: str, name: str) -> str:
    return (
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="4" fill="{colour}">'
        f"<title>{name}</title></circle>"
    )


def _scale_bar(scale: float, width: float, height: float) -> str:
    metres = max([m for m in _SCALE_BARS if m * scale <= 0.25 * width], default=0.1)
    x0, x1, y = 12.0, 12.0 + metres * scale, height - 14.0
    return (
        f'<path d="M{x0} {y:.1f}H{x1:.1f}" stroke="#000" stroke-width="3"/>'
        f'<text x="{x0}" y="{y - 6:.1f}" font-size="13" font-family="sans-serif">{metres} m</text>'
    )


def curve(times_s: NDArray[np.float64], values: NDArray[np.float64], colour: str, unit: str) -> str:
    """SVG of a value over time, with its largest value marked."""
    width, height, left, foot = 960.0, 150.0, 60.0, 22.0
    top = float(values.max()) if len(values) and values.max() > 0 else 1.0
    span = max(float(times_s[-1] - times_s[0]), 1e-9)
    keep = slice(None, None, max(1, len(values) // _POINTS))
    x = left + (times_s[keep] - times_s[0]) / span * (width - left - 4)
    y = (height - foot) - values[keep] / top * (height - foot - 12)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    base = height - foot
    text = 'font-size="12" font-family="sans-serif"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
        f'<path d="M{left} {base}H{width}M{left} {base}V8" stroke="#999" fill="none"/>'
        f'<text x="2" y="18" {text}>{top:.3g} {unit}</text><text x="2" y="{base}" {text}>0</text>'
        f'<text x="{width - 60}" y="{height - 4}" {text}>{span:.0f} s</text>'
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/></svg>'
    )
