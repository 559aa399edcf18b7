"""Which scans are worth comparing, given where they are: neighbours in time and in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.geometry import wrap_angle

_IN_TIME = (1, 2, 4, 8)  # scans ahead that each scan is compared with
_METRES_PER_RADIAN = 1.5  # how much farther a scan counts for looking elsewhere


def neighbour_pairs(
    poses: NDArray[np.float64], radius: float, passes: int, gap: int = 9
) -> NDArray[np.int64]:
    """(P, 2) ascending pairs of scan indices: close in time, or of another pass nearby.

    Of each earlier or later pass within `radius` metres the nearest scan is taken, `passes`
    passes at most, so that the cost grows with the drive and not with its square.
    """
    count = len(poses)
    found: set[tuple[int, int]] = set()
    for ahead in _IN_TIME:
        found.update((i, i + ahead) for i in range(count - ahead))
    tree = cKDTree(poses[:, :2])
    for i, near in enumerate(tree.query_ball_point(poses[:, :2], radius, return_sorted=True)):
        others = np.asarray(near)
        others = others[np.abs(others - i) >= gap]
        if len(others) == 0:
            continue
        turn = np.abs(wrap_angle(poses[others, 2] - poses[i, 2]))
        cost = np.hypot(*(poses[others, :2] - poses[i, :2]).T) + _METRES_PER_RADIAN * turn
        runs = np.cumsum(np.diff(others, prepend=others[0]) > gap)
        best = [others[runs == r][np.argmin(cost[runs == r])] for r in range(runs[-1] + 1)]
        costs = [cost[runs == r].min() for r in range(runs[-1] + 1)]
        for k in np.argsort(costs, kind="stable")[:passes]:
            j = int(best[k])
            found.add((min(i, j), max(i, j)))
    return np.array(sorted(found), np.int64).reshape(-1, 2)
