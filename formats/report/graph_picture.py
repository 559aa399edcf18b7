"""A picture of the graph over the grid: path, closures, what was rejected, the start."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from formats.report.map_axes import (
    WIDTH,
    draw_graph,
    draw_lines,
    figure_file,
    legend,
    plan_axes,
)
from mapmyworld.geometry import Array
from mapmyworld.types import Judged, OccupancyGrid, Poses

_TREE = "#1e821e"  # landmarks
_AXIS = 0.03  # of the graph's extent: the start's axes


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
