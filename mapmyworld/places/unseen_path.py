"""What a tracking loss means for recognition: as if the robot had moved on, unobserved.

Metres of path say where a submap ends and what counts as another visit. So at a loss the path grows
by more than maps reach: no submap spans a loss, and no way across one is the shortest.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.odometry.unobserved_motion import FARTHEST
from mapmyworld.types import Constraint

Array = NDArray[np.float64]


def unseen_path(ids: NDArray[np.int64], constraints: Iterable[Constraint]) -> Array:
    """Metres of path that losses add between each of ascending nodes and the last, (N,) both."""
    added = np.zeros(len(ids))
    row = np.searchsorted(ids, [c.to_id for c in constraints if c.is_tracking_loss])
    added[row[row < len(ids)]] = FARTHEST
    return added
