"""A map from above as a file: its graph, a path found in it, particles, several maps at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.report.map_axes import (
    WIDTH,
    caption,
    draw_graph,
    draw_grid,
    draw_lines,
    draw_rings,
    figure_file,
    frame,
    legend,
    observed_corners,
    plan_axes,
)
from mapmyworld.geometry import Array
from mapmyworld.types import Judged, OccupancyGrid, Poses
from mapmyworld.types.localisation import Localisation, State

_BLUE, _ORANGE, _GREEN = "#1e5ac8", "#f0963c", "#009646"
_TREE = "#1e821e"  # landmarks
_AXIS = 0.03  # of the graph's extent: the start's axes
_LEAP = 1.0  # m between neighbouring moments, beyond which no line is drawn
_COLUMNS = 3  # of maps, at most


def write_graph_picture(
    path: Path,
    poses: Poses,
    constraints: Sequence[Judged],
    grid: OccupancyGrid | None = None,
    landmarks: Array | None = None,
) -> None:
    """The picture, seen from above, by the name's ending.

    `landmarks` (L, 2 or 3) are positions in the map, m.
    """
    places = poses.map_from_node[:, :2, 3]
    shown = places if landmarks is None else np.vstack([places, landmarks[:, :2]])
    with figure_file(path, WIDTH) as figure:
        axes = plan_axes(figure, grid, shown)
        draw_graph(axes, dict(zip(poses.ids.tolist(), places, strict=True)), constraints)
        if landmarks is not None:
            style = {"color": _TREE, "ms": 3, "label": f"landmark ({len(landmarks)})"}
            axes.plot(landmarks[:, 0], landmarks[:, 1], ".", **style)
        if len(places):
            start, length = poses.map_from_node[0], _AXIS * max(np.ptp(places, axis=0).max(), 1.0)
            for axis, colour in ((0, "red"), (1, "green")):
                ends = np.stack([start[:2, 3], start[:2, 3] + length * start[:2, axis]])
                draw_lines(axes, ends[None], colour, f"start, {'xy'[axis]}", 2.0)
        legend(axes)


def write_localisation_picture(path: Path, grid: OccupancyGrid, found: Localisation) -> None:
    """The grid under the path: tracked, known afterwards, and first recognitions."""
    places = np.array([e.map_from_base[:2, 3] for e in found.estimates]).reshape(-1, 2)
    lost = np.array([e.state == State.LOST for e in found.estimates], np.bool_)
    known = np.array([e.known for e in found.estimates], np.bool_)
    again = np.flatnonzero(~lost & np.concatenate([[True], lost[:-1]]))
    with figure_file(path, WIDTH) as figure:
        axes = plan_axes(figure, grid, places)
        draw_lines(axes, _steps(places, known & lost), _ORANGE, "worked out afterwards", 1.2)
        tracked = f"tracked ({np.mean(~lost):.1%} of {len(places)} moments)"
        draw_lines(axes, _steps(places, ~lost), _BLUE, tracked, 1.2)
        draw_rings(axes, places[again], _GREEN, f"recognised after being lost ({len(again)})")
        legend(axes)


def _steps(places: NDArray[np.float64], which: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(L, 2, 2) between neighbouring moments of which both count."""
    both = which[1:] | which[:-1]
    near = np.hypot(*np.diff(places, axis=0).T) < _LEAP if len(places) > 1 else both
    ends = np.stack([places[:-1], places[1:]], axis=1)
    return np.asarray(ends[both & near])


def write_particle_picture(
    path: Path,
    grid: OccupancyGrid,
    branches: NDArray[np.floating],
    best: NDArray[np.floating],
    loops: NDArray[np.floating],
) -> None:
    """The grid under all particles' paths `branches` (S, 2, 2) and the best one, `best` (K, 2).

    `loops` (L, 2) are the places at which it came back; all in the map, metres.
    """
    with figure_file(path, WIDTH) as figure:
        axes = plan_axes(figure, grid, best)
        draw_lines(axes, branches, _ORANGE, "all particles", 0.6)
        steps = np.stack([best[:-1], best[1:]], axis=1)
        draw_lines(axes, steps, _BLUE, f"the best one, {len(best)} updates", 0.8)
        draw_rings(axes, loops, _GREEN, f"{len(loops)} returns to known places")
        legend(axes)


@dataclass(frozen=True, slots=True, eq=False)
class MapPanel:
    """One of the maps, moved into the frame of the first."""

    grid: OccupancyGrid
    first_from_map: NDArray[np.float64]
    """(3,) x, y, yaw that lays this map upon the first."""
    path: NDArray[np.float64]
    """(K, 2) in this map's own frame."""
    captions: tuple[str, ...]


def write_compare_picture(path: Path, panels: Sequence[MapPanel]) -> None:
    """The maps side by side, two or three a row, each with its captions below."""
    from matplotlib.transforms import Affine2D

    moves = [
        Affine2D().rotate(p.first_from_map[2]).translate(*p.first_from_map[:2]) for p in panels
    ]
    seen = [m.transform(observed_corners(p.grid)) for p, m in zip(panels, moves, strict=True)]
    columns = min(len(panels) if len(panels) < 4 else (len(panels) + 1) // 2, _COLUMNS)
    rows = -(-len(panels) // columns)
    width, height = np.ptp(np.concatenate(seen), axis=0)
    with figure_file(path, rows * (WIDTH / columns * height / width + 0.4)) as figure:
        cells = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in cells:
            axes.set_aspect("equal")
            axes.axis("off")
        for axes, panel, move in zip(cells, panels, moves, strict=False):
            draw_grid(axes, panel.grid, move)
            axes.plot(*move.transform(panel.path.reshape(-1, 2)).T, color=_BLUE, lw=0.6)
            frame(axes, np.concatenate(seen))
            text = "\n".join(map(caption, panel.captions))
            axes.set_title(text, fontsize=6, y=0.0, va="top")
