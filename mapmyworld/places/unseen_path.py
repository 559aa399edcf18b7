"""What a tracking loss means for recognition: as if the robot had moved on, unobserved.

Metres of path say where a submap ends, how far a search reaches and what counts as another visit.
So at a loss the path grows by as many as it takes to drift by half a turn: no submap spans a loss,
and the places before it are looked for from those after it in any heading.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import PlacesConfig
from mapmyworld.types import Constraint

Array = NDArray[np.float64]


def unseen_path(
    ids: NDArray[np.int64], constraints: Iterable[Constraint], config: PlacesConfig
) -> Array:
    """Metres of path that losses add between each of ascending nodes and the last, (N,) both."""
    added = np.zeros(len(ids))
    row = np.searchsorted(ids, [c.to_id for c in constraints if c.is_tracking_loss])
    added[row[row < len(ids)]] = np.pi / config.laser_drift_angle
    return added
