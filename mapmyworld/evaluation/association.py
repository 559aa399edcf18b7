"""Which poses of two trajectories belong to the same moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.types import Trajectory

MAX_DIFFERENCE_S = 0.01  # between two stamps of one moment; evo's default


def associate(
    first: Trajectory, second: Trajectory, max_difference_s: float = MAX_DIFFERENCE_S
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(K,) indices into `first` and (K,) into `second` of poses of the same moments.

    Each pose of the shorter trajectory takes the one of the longer that is nearest in time (as evo
    does). Raises `MapError` where no pair is near enough.
    """
    second_longer = len(second.stamps_ns) > len(first.stamps_ns)
    short, long = (first, second) if second_longer else (second, first)
    if len(short.stamps_ns) == 0:
        raise MapError("a trajectory without poses cannot be compared with another")
    nearest = nearest_stamps(long.stamps_ns, short.stamps_ns)
    difference = np.abs(long.stamps_ns[nearest] - short.stamps_ns)
    kept = np.flatnonzero(difference <= round(max_difference_s * 1e9))
    if len(kept) == 0:
        raise MapError(_nothing_common(first, second, max_difference_s))
    return (kept, nearest[kept]) if second_longer else (nearest[kept], kept)


def nearest_stamps(stamps_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """(W,) for each wanted stamp (W,) the index of the nearest one of `stamps_ns` (N,).

    These need not be sorted.
    """
    order = np.argsort(stamps_ns, kind="stable")
    ordered = stamps_ns[order]
    twice_the_middles = ordered[1:] + ordered[:-1]
    return np.asarray(order[np.searchsorted(twice_the_middles, 2 * wanted_ns)], np.int64)


def _nothing_common(first: Trajectory, second: Trajectory, max_difference_s: float) -> str:
    ends = [(t.stamps_ns.min() * 1e-9, t.stamps_ns.max() * 1e-9) for t in (first, second)]
    spans = [f"{start:.3f} to {end:.3f} s" for start, end in ends]
    apart = ends[0][1] < ends[1][0] or ends[1][1] < ends[0][0]
    advice = (
        "compare trajectories of the same log"
        if apart
        else "allow a larger difference (evaluate trajectory --max-difference)"
    )
    return (
        f"no two poses lie within {max_difference_s} s of each other: one trajectory has stamps "
        f"from {spans[0]}, the other from {spans[1]}; {advice}"
    )
