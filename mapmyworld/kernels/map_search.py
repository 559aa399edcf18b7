"""Inner loops of localisation: rays through a grid, and how points go with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit


@jit
def cast_rays(
    occupied: NDArray[np.bool_],
    known: NDArray[np.bool_],
    x: float,
    y: float,
    bearings: NDArray[np.float64],
    reach: float,
    hits: NDArray[np.float64],
) -> int:
    """Fills `hits` (N, 2) with the middles of the first occupied cells along rays; gives their
    count.

    Everything is in cells, of grids `occupied` and `known` (H, W). A ray, of which `bearings` (N,)
    gives the direction in rad, that leaves what is known, or `reach`, hits nothing.
    """
    height, width = occupied.shape
    count = 0
    for k in range(len(bearings)):
        c, s = np.cos(bearings[k]), np.sin(bearings[k])
        travelled = 0.0
        while travelled < reach:
            column, row = int(np.floor(x + travelled * c)), int(np.floor(y + travelled * s))
            if row < 0 or column < 0 or row >= height or column >= width:
                break
            if occupied[row, column]:
                hits[count, 0], hits[count, 1] = column + 0.5, row + 0.5
                count += 1
                break
            if not known[row, column]:
                break
            travelled += 0.5
    return count
