"""A picture of where a robot was in a finished map: its known path over the grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.report.map_axes import (
    WIDTH,
    draw_lines,
    draw_rings,
    figure_file,
    legend,
    plan_axes,
)
from mapmyworld.types import OccupancyGrid
from mapmyworld.types.localisation import Localisation, State

_TRACKED, _AFTERWARDS, _FOUND = "#1e5ac8", "#f0963c", "#009646"
_LEAP = 1.0  # m between neighbouring moments, beyond which no line is drawn


def write_localisation_picture(path: Path, grid: OccupancyGrid, found: Localisation) -> None:
    """The grid under the path: tracked, known afterwards, and first recognitions."""
    places = np.array([e.map_from_base[:2, 3] for e in found.estimates]).reshape(-1, 2)
    lost = np.array([e.state == State.LOST for e in found.estimates], np.bool_)
    known = np.array([e.known for e in found.estimates], np.bool_)
    again = np.flatnonzero(~lost & np.concatenate([[True], lost[:-1]]))
    with figure_file(path, WIDTH) as figure:
        axes = plan_axes(figure, grid, places)
        draw_lines(axes, _lines(places, known & lost), _AFTERWARDS, "worked out afterwards", 1.2)
        tracked = f"tracked ({np.mean(~lost):.1%} of {len(places)} moments)"
        draw_lines(axes, _lines(places, ~lost), _TRACKED, tracked, 1.2)
        draw_rings(axes, places[again], _FOUND, f"recognised after being lost ({len(again)})")
        legend(axes)


def _lines(places: NDArray[np.float64], which: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(L, 2, 2) between neighbouring moments of which both count."""
    both = which[1:] | which[:-1]
    near = np.hypot(*np.diff(places, axis=0).T) < _LEAP if len(places) > 1 else both
    ends = np.stack([places[:-1], places[1:]], axis=1)
    return np.asarray(ends[both & near])
