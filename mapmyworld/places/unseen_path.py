"""What a tracking loss means for recognition: as if the robot had moved on, unobserved.

Metres of path say where a submap ends, how far a search reaches and what counts as another visit.
So at a loss the path grows by as many as it takes to drift as far as the robot may be off: no
submap spans a loss, and the places before it are looked for from those after it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import PlacesConfig
from mapmyworld.geometry.planar import information_to_planar
from mapmyworld.types import Constraint

Array = NDArray[np.float64]
_SIGMAS = 3.0
_LEAST, _MOST = 20.0, 750.0  # m of path that a loss counts for; after the most any heading is open


def unseen_path(
    ids: NDArray[np.int64], constraints: Iterable[Constraint], config: PlacesConfig
) -> Array:
    """Metres of path that losses add between each of ascending nodes and the last, (N,) both."""
    losses = [c for c in constraints if c.is_tracking_loss]
    added = np.zeros(len(ids))
    if not losses:
        return added
    planar = information_to_planar(np.stack([c.information for c in losses]))
    sigmas = np.sqrt(np.linalg.inv(planar)[:, (0, 1, 2), (0, 1, 2)])
    metres = _SIGMAS * np.maximum(
        sigmas[:, :2].max(axis=1) / config.laser_drift, sigmas[:, 2] / config.laser_drift_angle
    )
    row = np.searchsorted(ids, [c.to_id for c in losses])
    known = row < len(ids)
    np.add.at(added, row[known], np.clip(metres, _LEAST, _MOST)[known])
    return added
