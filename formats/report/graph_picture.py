"""A picture of the graph over the grid: path, closures, what was rejected, the start."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.constraint_kinds import COLOURS, rgb
from formats.report.picture_file import write_picture
from mapmyworld.geometry import Array
from mapmyworld.types import ConstraintKind, Judged, OccupancyGrid, Poses

_SIZE = 1400  # pixels of the longer side
_MARGIN = 40  # pixels
_DASH = 7.0  # pixels of a dot's period
# Blue, green, red, as OpenCV wants them.
_COLOURS = {kind: rgb(colour)[::-1] for kind, colour in COLOURS.items()}
_WORDS = {
    ConstraintKind.NEIGHBOUR: "path",
    ConstraintKind.LOOP_CLOSURE: "loop closure",
    ConstraintKind.PROXIMITY: "proximity",
    ConstraintKind.LANDMARK: "landmark",
    ConstraintKind.USER: "by hand",
}


def draw_graph(
    poses: Poses,
    constraints: Sequence[Judged],
    grid: OccupancyGrid | None = None,
    landmarks: Array | None = None,
) -> NDArray[np.uint8]:
    """The picture (H, W, 3), blue first, seen from above, y upwards, equal scales.

    `landmarks` (L, 2 or 3) are positions in the map, m.
    """
    view = _View(poses, grid, landmarks)
    picture = view.background(grid)
    at = dict(zip(poses.ids.tolist(), view.pixels(poses.map_from_node[:, :2, 3]), strict=True))
    drawn: set[tuple[ConstraintKind, bool]] = set()
    for accepted in (False, True):
        for c in constraints:
            if c.accepted is not accepted or c.from_id not in at or c.to_id not in at:
                continue
            if c.from_id != c.to_id and c.kind != ConstraintKind.NEIGHBOUR:
                _line(picture, at[c.from_id], at[c.to_id], _COLOURS[c.kind], dotted=not accepted)
                drawn.add((c.kind, accepted))
    for c in constraints:
        if c.kind == ConstraintKind.NEIGHBOUR and c.accepted and {c.from_id, c.to_id} <= set(at):
            _line(picture, at[c.from_id], at[c.to_id], _COLOURS[c.kind], width=2)
    if landmarks is not None:
        for point in view.pixels(landmarks):
            cv2.circle(picture, _rounded(point), 4, (30, 130, 30), -1, cv2.LINE_AA)
    _axes(picture, view, poses)
    _legend(picture, view, drawn, landmarks is not None)
    return picture


def write_graph_picture(
    path: Path,
    poses: Poses,
    constraints: Sequence[Judged],
    grid: OccupancyGrid | None = None,
    landmarks: Array | None = None,
) -> None:
    """The picture as PNG (or what else the name's ending says).

    `landmarks` (L, 2 or 3) are positions in the map, m.
    """
    picture = draw_graph(poses, constraints, grid, landmarks)
    write_picture(path, picture[:, :, ::-1])


class _View:
    """From metres to pixels."""

    def __init__(self, poses: Poses, grid: OccupancyGrid | None, landmarks: Array | None) -> None:
        corners = [poses.map_from_node[:, :2, 3]]
        if landmarks is not None and len(landmarks):
            corners.append(landmarks[:, :2])
        if grid is not None and np.isfinite(grid.log_odds).any():
            rows, columns = np.nonzero(np.isfinite(grid.log_odds))
            cells = np.array([[columns.min(), rows.min()], [columns.max(), rows.max()]])
            corners.append(grid.origin + cells * grid.resolution)
        points = np.concatenate(corners) if len(poses.ids) else np.zeros((1, 2))
        self.low = points.min(axis=0)
        extent = np.maximum(points.max(axis=0) - self.low, 1e-3)
        self.scale = float((_SIZE - 2 * _MARGIN) / extent.max())
        self.width, self.height = (np.ceil(extent * self.scale) + 2 * _MARGIN).astype(int).tolist()

    def pixels(self, points: Array) -> Array:
        """Columns and rows (N, 2) of points (N, 2) in metres."""
        columns = (points[:, 0] - self.low[0]) * self.scale + _MARGIN
        rows = self.height - 1 - ((points[:, 1] - self.low[1]) * self.scale + _MARGIN)
        return np.column_stack([columns, rows])

    def background(self, grid: OccupancyGrid | None) -> NDArray[np.uint8]:
        """White, or the grid: free cells white, occupied dark, unknown light grey."""
        if grid is None:
            return np.full((self.height, self.width, 3), 255, np.uint8)
        cells = grid.trinary()
        shades = np.full(cells.shape, 225, np.uint8)
        shades[cells == 0], shades[cells == 100] = 255, 60
        corner = np.array([[grid.origin[0], grid.origin[1]]])
        left, bottom = self.pixels(corner)[0]
        size = grid.resolution * self.scale
        # Row r of the grid is at image row bottom - r * size.
        motion = np.array([[size, 0.0, left + 0.5 * size], [0.0, -size, bottom - 0.5 * size]])
        picture = cv2.warpAffine(
            shades,
            motion,
            (self.width, self.height),
            flags=cv2.INTER_AREA if size < 1 else cv2.INTER_NEAREST,
            borderValue=225,
        )
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), np.uint8)


def _rounded(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _line(
    picture: NDArray[np.uint8],
    a: Array,
    b: Array,
    colour: tuple[int, int, int],
    *,
    dotted: bool = False,
    width: int = 1,
) -> None:
    if not dotted:
        cv2.line(picture, _rounded(a), _rounded(b), colour, width, cv2.LINE_AA)
        return
    count = max(1, int(np.hypot(*(b - a)) / _DASH))
    for k in range(count):
        p, q = a + (b - a) * (k / count), a + (b - a) * ((k + 0.4) / count)
        cv2.line(picture, _rounded(p), _rounded(q), colour, width, cv2.LINE_AA)


def _axes(picture: NDArray[np.uint8], view: _View, poses: Poses) -> None:
    """The first node's frame: x red, y green."""
    if len(poses.ids) == 0:
        return
    start = poses.map_from_node[0]
    length = 35.0 / view.scale
    for axis, colour in ((0, (0, 0, 255)), (1, (0, 170, 0))):
        ends = np.stack([start[:2, 3], start[:2, 3] + length * start[:2, axis]])
        a, b = view.pixels(ends)
        cv2.arrowedLine(picture, _rounded(a), _rounded(b), colour, 3, cv2.LINE_AA, tipLength=0.3)


def _legend(
    picture: NDArray[np.uint8],
    view: _View,
    drawn: set[tuple[ConstraintKind, bool]],
    landmarks: bool,
) -> None:
    """What each line means, as it is drawn; the path first, then every kind, accepted and not."""
    kinds = [*_WORDS, *sorted({kind for kind, _ in drawn} - _WORDS.keys())]
    rows = []
    for kind in kinds:
        word = _WORDS.get(kind, kind.replace("_", " "))
        if kind == ConstraintKind.NEIGHBOUR or (kind, True) in drawn:
            rows.append((word, _COLOURS[kind], False))
        if (kind, False) in drawn:
            rows.append((f"{word}, rejected", _COLOURS[kind], True))
    if landmarks:
        rows.append(("landmark", (30, 130, 30), False))
    metres = _round_length(min(0.2 * view.width, 100.0) / view.scale)
    cv2.rectangle(picture, (6, 6), (230, 34 + 22 * len(rows)), (255, 255, 255), -1)
    for n, (word, colour, dotted) in enumerate(rows):
        y = 20.0 + 22 * n
        _line(picture, np.array([14.0, y]), np.array([46.0, y]), colour, dotted=dotted, width=2)
        _text(picture, word, (54, int(y) + 5))
    y, bar = 20 + 22 * len(rows), round(metres * view.scale)
    cv2.line(picture, (14, y), (14 + bar, y), (0, 0, 0), 2)
    _text(picture, f"{metres:g} m", (22 + bar, y + 5))


def _round_length(metres: float) -> float:
    decade = 10.0 ** np.floor(np.log10(max(metres, 1e-6)))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= metres * 1.0001))


def _text(picture: NDArray[np.uint8], text: str, at: tuple[int, int]) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA)
