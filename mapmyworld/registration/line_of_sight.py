"""What a laser sees through: points beyond the surfaces that other scans met."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_matching import PreparedScan, ScanSet, scan_set
from mapmyworld.registration.scan_search import Submap

Array = NDArray[np.float64]


def share_seen_through(scan: PreparedScan, targets: ScanSet, poses: Array, pose: Array) -> float:
    """Share of the targets' points that a scan, taken at a pose (3,), would have seen through.

    Of those that lie where it saw anything: what comes from nearer may be somebody in the way, and
    hides the targets, at `poses` (S, 3).
    """
    view = Place.of(Submap.of(scan_set([scan]), np.zeros((1, 3))))
    seen = Place.of(Submap.of(targets, poses)).agreement_with(view, pose).back
    through, met = int((seen < 0).sum()), int((seen > 0).sum())
    return through / max(through + met, 1)
