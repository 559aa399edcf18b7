"""A picture of where a robot was in a finished map: its known path over the grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formats.report.grid_canvas import canvas_from_grid
from formats.report.match_picture import Picture, with_caption
from mapmyworld.types import OccupancyGrid
from mapmyworld.types.localisation import Localisation, State

_TRACKED = (30, 90, 200)  # RGB
_AFTERWARDS = (240, 150, 60)
_FOUND = (0, 150, 70)
_SIDE = 1000  # pixels of the longer side
_LEAP = 1.0  # m between neighbouring moments, beyond which no line is drawn


def localisation_picture(grid: OccupancyGrid, found: Localisation) -> Picture:
    """The grid (H, W, 3) RGB under the path: tracked, known afterwards, and first recognitions."""
    canvas = canvas_from_grid(grid, _SIDE)
    places = np.array([e.map_from_base[:2, 3] for e in found.estimates]).reshape(-1, 2)
    lost = np.array([e.state == State.LOST for e in found.estimates], np.bool_)
    known = np.array([e.known for e in found.estimates], np.bool_)
    canvas.draw_lines(_lines(places, known & lost), _AFTERWARDS, 2)
    canvas.draw_lines(_lines(places, ~lost), _TRACKED, 2)
    again = np.flatnonzero(~lost & np.concatenate([[True], lost[:-1]]))
    canvas.draw_rings(places[again], _FOUND)
    caption = (
        f"{len(places)} moments; blue: tracked ({np.mean(~lost):.1%}), orange: worked out "
        f"afterwards, green: recognised after being lost ({len(again)})"
    )
    return with_caption(canvas.pixels, caption)


def _lines(places: NDArray[np.float64], which: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(L, 2, 2) between neighbouring moments of which both count."""
    both = which[1:] | which[:-1]
    near = np.hypot(*np.diff(places, axis=0).T) < _LEAP if len(places) > 1 else both
    ends = np.stack([places[:-1], places[1:]], axis=1)
    return np.asarray(ends[both & near])
