"""The map from above as SVG in layers: grid, paths, constraints by verdict, nodes, the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from PIL import Image

from formats.constraint_kinds import COLOURS
from formats.report.contents import ReportContents, ShownConstraint
from formats.report.map_axes import observed_corners
from formats.report.page import data_uri
from mapmyworld.geometry import Array
from mapmyworld.types import ConstraintKind, OccupancyGrid

_WIDTH, _HEIGHT = 1000.0, 760.0  # pixels that the map fills at most
_PATH_POINTS = 6000  # of a path that are drawn
_ELLIPSES = 60  # along the path
_SIGMAS = 3.0  # of the ellipses
_BARS = tuple(step * 10.0**power for power in range(-2, 4) for step in (1, 2, 5))  # m
_SEEN = 255, 30  # grey of free and occupied cells; behind unknown ones the page shows


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Something on the map that can be taken away."""

    key: str
    title: str
    svg: str
    shown: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """From metres to the picture's pixels, y upwards."""

    low: Array
    """(2,) m, x and y of the lower left corner."""
    high: Array
    """(2,) m, of the upper right one."""
    scale: float

    @property
    def size(self) -> Array:
        """(2,) width and height in pixels."""
        return (self.high - self.low) * self.scale

    def pixels(self, points: Array) -> Array:
        """Pixels, x and y, of points in metres on the picture, (..., 2) both."""
        moved = (points - self.low) * self.scale
        return np.stack([moved[..., 0], self.size[1] - moved[..., 1]], axis=-1)


def view_of(contents: ReportContents) -> View:
    """What is shown: the path, and the cells that were seen."""
    corners = [contents.path[:, 1:], contents.nodes.places[:, :2]]
    if contents.grid is not None:
        corners.append(observed_corners(contents.grid))
    points = np.concatenate(corners)
    points = points if len(points) else np.zeros((1, 2))
    margin = 0.03 * float(np.ptp(points, axis=0).max()) + 0.1
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return View(low, high, float(min(_WIDTH / (high[0] - low[0]), _HEIGHT / (high[1] - low[1]))))


def layers_of(contents: ReportContents, view: View) -> list[Layer]:
    """Bottom to top; layers with nothing in them are left out."""
    nodes = contents.nodes
    place = dict(zip(nodes.ids.tolist(), view.pixels(nodes.places[:, :2]), strict=True))
    found = [Layer("grid", "grid", _grid_image(contents.grid, view))]
    found.append(
        Layer("odometry", "odometry alone", _line(view.pixels(contents.odometry)), shown=False)
    )
    rejected = [c for c in contents.constraints if not c.accepted]
    found.append(Layer("rejected", "rejected", _segments(rejected, place), shown=False))
    found.append(Layer("sigma", "3 sigma", _ellipses(contents, view), shown=False))
    found.append(Layer("path", "path", _line(view.pixels(contents.path[:, 1:]))))
    for kind in COLOURS:
        if kind != ConstraintKind.NEIGHBOUR:  # which the path shows
            mine = [c for c in contents.constraints if c.accepted and c.kind == kind]
            key, title = str(kind).removesuffix("_closure"), str(kind).replace("_", " ")
            found.append(Layer(key, title, _segments(mine, place)))
    found.append(Layer("nodes", "nodes", _dots(view.pixels(nodes.places[:, :2])), shown=False))
    found.append(Layer("start", "start axes", _axes(nodes.places, view)))
    return [layer for layer in found if layer.svg]


def map_svg(layers: Sequence[Layer], view: View) -> str:
    """The picture; its transform stands in data attributes, for the page's script."""
    width, height = view.size
    groups = "".join(
        f'<g class="layer layer-{layer.key}" data-layer="{layer.key}"'
        f"{'' if layer.shown else ' hidden'}>{layer.svg}</g>"
        for layer in layers
    )
    return (
        f'<svg id="map" xmlns="http://www.w3.org/2000/svg" role="img" tabindex="0"'
        f' aria-label="The map from above" viewBox="0 0 {width:.1f} {height:.1f}"'
        f' data-scale="{view.scale:.9g}" data-left="{view.low[0]:.9g}"'
        f' data-top="{view.high[1]:.9g}"><g id="view">{groups}<g id="marks"></g></g>'
        f"{_scale_bar(view)}</svg>"
    )


def _grid_image(grid: OccupancyGrid | None, view: View) -> str:
    if grid is None:
        return ""
    cells = grid.trinary()[::-1]
    colours = np.zeros(256, np.uint8)  # of the palette: the first lets the page through
    colours[[0, 100]] = 1, 2
    picture, written = Image.fromarray(colours[cells.view(np.uint8)]), BytesIO()
    picture.putpalette([shade for shade in (0, *_SEEN) for _ in "RGB"])
    picture.save(written, "PNG", transparency=0, bits=2)
    data = written.getvalue()
    left, top = view.pixels(grid.origin + np.array([0.0, cells.shape[0] * grid.resolution]))
    width, height = (side * grid.resolution * view.scale for side in cells.shape[::-1])
    return (
        f'<image class="cells" x="{left:.2f}" y="{top:.2f}" width="{width:.2f}"'
        f' height="{height:.2f}" preserveAspectRatio="none" href="{data_uri(data)}"/>'
    )


def _line(points: Array) -> str:
    if len(points) < 2:
        return ""
    kept = np.round(points[:: max(1, len(points) // _PATH_POINTS)], 1)
    text = " ".join(f"{x:g},{y:g}" for x, y in kept.tolist())
    return f'<polyline points="{text}"/>'


def _segments(constraints: Sequence[ShownConstraint], place: dict[int, Array]) -> str:
    ends = [
        (*place[c.from_id], *place[c.to_id])
        for c in constraints
        if c.from_id in place and c.to_id in place and c.from_id != c.to_id
    ]
    text = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in ends)
    return f'<path d="{text}"/>' if text else ""


def _dots(points: Array) -> str:
    """Points of a size that zooming does not change: strokes of no length with round ends."""
    text = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points.tolist())
    return f'<path d="{text}"/>' if text else ""


def _ellipses(contents: ReportContents, view: View) -> str:
    nodes = contents.nodes
    if nodes.ellipses is None or len(nodes.ids) == 0:
        return ""
    chosen = np.unique(np.linspace(0, len(nodes.ids) - 1, _ELLIPSES).astype(int))
    centres = view.pixels(nodes.places[chosen, :2])
    parts = []
    for (x, y), (a, b, angle) in zip(centres, nodes.ellipses[chosen], strict=True):
        rx, ry = (_SIGMAS * view.scale * half for half in (a, b))
        turn = f"rotate({-np.degrees(angle):.1f} {x:.1f} {y:.1f})"
        parts.append(
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{rx:.2f}" ry="{ry:.2f}" transform="{turn}"/>'
        )
    return "".join(parts)


def _axes(places: Array, view: View) -> str:
    """The frame of the first node: x red, y green."""
    if len(places) == 0:
        return ""
    (x, y), yaw = view.pixels(places[:1, :2])[0], places[0, 2]
    length, parts = 30.0, []
    for key, angle in (("x", yaw), ("y", yaw + np.pi / 2)):
        dx, dy = length * np.cos(angle), -length * np.sin(angle)
        parts.append(f'<path class="axis-{key}" d="M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"/>')
    return "".join(parts)


def _scale_bar(view: View) -> str:
    width, height = view.size
    metres = max([m for m in _BARS if m * view.scale <= 0.25 * width], default=_BARS[0])
    return (
        f'<g id="scale-bar" data-pixels="{metres * view.scale:.2f}" data-metres="{metres}">'
        f'<path d="M14 {height - 14:.1f}h{metres * view.scale:.1f}"/>'
        f'<text x="14" y="{height - 20:.1f}">{metres:g} m</text></g>'
    )
