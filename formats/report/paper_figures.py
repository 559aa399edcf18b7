"""Figures for papers and pull requests: PNG, SVG or PDF, the same bytes each time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from formats.constraint_kinds import PATH
from formats.report.contents import Evidence, ReportContents
from formats.report.map_axes import WIDTH, draw_graph, figure_file, legend, plan_axes
from mapmyworld.errors import MapError

_BLUE, _ORANGE = PATH, "#d98200"
_START, _END = "#00875f", "#d7301f"
_LOOPS = 6  # closures in one figure


def write_figure(path: Path, what: str, contents: ReportContents) -> None:
    """One figure; raises `MapError` for another ending, or where the map lacks what it shows."""
    with figure_file(path) as figure:
        _DRAWERS[what](figure, contents)


def _map(figure: Any, contents: ReportContents) -> None:
    axes = plan_axes(figure, contents.grid, contents.path[:, 1:])
    axes.plot(contents.path[:, 1], contents.path[:, 2], color=_BLUE, lw=0.8, label="path")
    if len(contents.path):
        axes.plot(*contents.path[0, 1:], "o", color=_START, ms=4, label="start")
        axes.plot(*contents.path[-1, 1:], "s", color=_END, ms=4, label="end")
    legend(axes)


def _graph(figure: Any, contents: ReportContents) -> None:
    nodes = contents.nodes
    axes = plan_axes(figure, contents.grid, nodes.places[:, :2])
    place = dict(zip(nodes.ids.tolist(), nodes.places[:, :2], strict=True))
    draw_graph(axes, place, contents.constraints)
    axes.plot(nodes.places[:, 0], nodes.places[:, 1], ".", color=_BLUE, ms=1.5)
    legend(axes)


def _loops(figure: Any, contents: ReportContents) -> None:
    ends = [(item, contents.constraints[item.index]) for item in contents.evidence]
    shown = [
        item for item, c in ends if c.accepted and {c.from_id, c.to_id} <= contents.scans.keys()
    ][:_LOOPS]
    if not shown:
        raise MapError("this map has no accepted closure between scans to draw")
    figure.set_size_inches(WIDTH, 2.3 * -(-len(shown) // 3))
    grid = figure.subplots(-(-len(shown) // 3), min(3, len(shown)), squeeze=False).ravel()
    for axes in grid[len(shown) :]:
        axes.axis("off")
    for axes, item in zip(grid, shown, strict=False):
        _loop(axes, item, contents)


def _loop(axes: Any, item: Evidence, contents: ReportContents) -> None:
    constraint = contents.constraints[item.index]
    x, y, yaw = item.measured
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    a, b = contents.scans[constraint.from_id], contents.scans[constraint.to_id]
    moved = b @ turn + [x, y]
    axes.plot(a[:, 0], a[:, 1], ".", ms=1.5, color=_BLUE)
    axes.plot(moved[:, 0], moved[:, 1], ".", ms=1.0, color=_ORANGE)
    before = "" if constraint.start is None else f", moved {constraint.start[0]:.2f} m"
    axes.set_title(f"{constraint.from_id} and {constraint.to_id}{before}", fontsize=7)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)


def _uncertainty(figure: Any, contents: ReportContents) -> None:
    nodes = contents.nodes
    if nodes.sigmas_m is None:
        raise MapError("this map holds no covariances to draw")
    figure.set_size_inches(WIDTH, 2.4)
    axes = figure.subplots()
    axes.plot(nodes.times_s, nodes.sigmas_m, color=_BLUE, lw=1)
    axes.set_xlabel("time, s")
    axes.set_ylabel("one sigma of position, m")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)


def _timing(figure: Any, contents: ReportContents) -> None:
    if contents.timing is None:
        raise MapError("no timing of its build beside this map (MAP.timing.json)")
    stages: Sequence[dict[str, Any]] = contents.timing["stages"]
    figure.set_size_inches(WIDTH, 0.6 + 0.3 * len(stages))
    axes = figure.subplots()
    names = [stage["name"] for stage in stages]
    rows = np.arange(len(stages))
    axes.barh(rows - 0.2, [s["wall_s"] for s in stages], 0.4, color=_BLUE, label="seconds")
    axes.barh(rows + 0.2, [s["cpu_s"] for s in stages], 0.4, color=_ORANGE, label="CPU seconds")
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    axes.legend()


_DRAWERS: dict[str, Callable[[Any, ReportContents], None]] = {
    "map": _map,
    "graph": _graph,
    "loops": _loops,
    "uncertainty": _uncertainty,
    "timing": _timing,
}
