"""A map from above on matplotlib's axes, in metres: grid, lines, the graph; pictures as files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.constraint_kinds import COLOURS, REJECTED
from formats.report.contents import ShownConstraint
from formats.whole_files import write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import ConstraintKind, Judged, OccupancyGrid

Floats = NDArray[np.floating[Any]]
ENDINGS = (".png", ".svg", ".pdf")
WIDTH = 6.3  # inches: a page's text
_DPI = 220
_MARGIN = 0.5  # m around what was observed
_UNKNOWN, _FREE, _OCCUPIED = 0.9, 1.0, 0.1  # shades of cells
_MARKED = 10.0  # points, across the ring about a place
_PLAIN: dict[Any, Any] = {
    "svg.hashsalt": "mapmyworld",
    "svg.fonttype": "path",
    "font.size": 8,
    "text.parse_math": False,  # names of files are what they are
}


@contextmanager
def figure_file(path: Path, height: float = 0.75 * WIDTH) -> Iterator[Any]:
    """A figure to draw on, a page wide, then written to the file: the same bytes each time.

    Raises `MapError` for a name that is no picture's.
    """
    if path.suffix.lower() not in ENDINGS:
        raise MapError(f"{path}: give a name that ends in {', '.join(ENDINGS)}")
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_PLAIN):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        yield figure
        ending, data = path.suffix.lower()[1:], BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        look: Any = {"format": ending, "dpi": _DPI, "bbox_inches": "tight"}
        figure.savefig(data, metadata=dates.get(ending), **look)
    write_whole(path, data.getvalue())


def caption(text: str) -> str:
    """Text that any font can draw, whatever bytes a file's name is of."""
    return text.encode("ascii", "replace").decode()


def plan_axes(figure: Any, grid: OccupancyGrid | None, places: Floats) -> Any:
    """Axes in metres that show places (N, 2) and the grid, as far as it was observed."""
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    shown = [np.asarray(places, np.float64).reshape(-1, 2)]
    if grid is not None:
        draw_grid(axes, grid)
        shown.append(observed_corners(grid))
    frame(axes, np.concatenate(shown))
    return axes


def draw_grid(axes: Any, grid: OccupancyGrid, into: Any = None) -> None:
    """Cells in shades of grey; `into` is a transform of matplotlib's, of the map to the axes."""
    cells = grid.trinary()
    shades = np.full(cells.shape, _UNKNOWN)
    shades[cells == 0], shades[cells == 100] = _FREE, _OCCUPIED
    (left, low), size = grid.origin, np.array(cells.shape[::-1]) * grid.resolution
    extent = (left, left + size[0], low, low + size[1])
    drawn = axes.imshow(shades, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent)
    if into is not None:
        drawn.set_transform(into + axes.transData)


def observed_corners(grid: OccupancyGrid) -> NDArray[np.float64]:
    """The four corners (4, 2), in metres, of what was observed; of all cells where nothing was."""
    seen = grid.trinary() >= 0
    if not seen.any():
        seen = ~seen
    r0, r1, c0, c1 = (
        edge for axis in (1, 0) for edge in np.flatnonzero(seen.any(axis=axis))[[0, -1]] + (0, 1)
    )
    corners = np.array([[c0, r0], [c1, r0], [c0, r1], [c1, r1]])
    return np.asarray(grid.origin + corners * grid.resolution)


def frame(axes: Any, points: Floats) -> None:
    """The axes show these points (N, 2), and a little around them."""
    if len(points):
        (left, low), (right, high) = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
        axes.set_xlim(left, right)
        axes.set_ylim(low, high)


def draw_lines(axes: Any, ends: Any, colour: str, label: str, width: float, **style: Any) -> None:
    """Straight lines (L, 2, 2); nothing where there are none."""
    from matplotlib.collections import LineCollection

    if len(ends):
        lines = LineCollection(ends, colors=colour, label=label, linewidths=width, **style)
        axes.add_collection(lines)


def draw_rings(axes: Any, places: Floats, colour: str, label: str) -> None:
    """Rings about places (N, 2)."""
    if len(places):
        look = {"mec": colour, "mfc": "none", "ms": _MARKED}
        axes.plot(places[:, 0], places[:, 1], "o", label=label, **look)


def draw_graph(
    axes: Any, place: Mapping[int, Floats], constraints: Iterable[Judged | ShownConstraint]
) -> None:
    """Lines between nodes at their places (2,), by kind; what was rejected lies below, dotted."""
    drawn: dict[ConstraintKind | None, list[tuple[Floats, Floats]]] = {}
    for c in constraints:
        if c.from_id != c.to_id and c.from_id in place and c.to_id in place:
            kind = c.kind if c.accepted else None
            drawn.setdefault(kind, []).append((place[c.from_id], place[c.to_id]))
    rejected = drawn.pop(None, [])
    label = f"rejected ({len(rejected)})"
    draw_lines(axes, rejected, REJECTED, label, 0.3, linestyles="dotted")
    for kind, colour in COLOURS.items():
        ends = drawn.get(kind, [])
        width = 1.0 if kind == ConstraintKind.NEIGHBOUR else 0.7
        draw_lines(axes, ends, colour, f"{str(kind).replace('_', ' ')} ({len(ends)})", width)


def legend(axes: Any) -> None:
    """What the lines mean, beside the axes."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
