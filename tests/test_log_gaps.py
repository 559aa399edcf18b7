"""Gaps of a log: frames unusually long after the one before, by what is usual for that log."""

from __future__ import annotations

import numpy as np

from mapmyworld.config import SensingConfig
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.stages.nodes import Motion, NodeSelector
from mapmyworld.types import Frame, LaserTracking


def gaps(stamps_s: np.ndarray) -> list[int]:
    """Which of the frames at these times (N,), all of them nodes, come after a gap."""
    selector = NodeSelector(SensingConfig(), wants_images=False)
    found = []
    for k, stamp_s in enumerate(stamps_s.tolist()):
        pose = planar_to_matrix([0.5 * k, 0.0, 0.0])
        motion = Motion(pose, np.eye(6) * 1e-4, LaserTracking("matched", 1.0))
        _, step, _ = selector.consider(Frame(round(1e9 * stamp_s), pose), motion)
        by = None if step is None else step.source
        found += [k] if isinstance(by, LaserTracking) and by.after_gap else []
    return found


def test_seconds_without_a_scan_are_a_gap_where_ten_a_second_are_usual() -> None:
    stamps = 0.1 * np.arange(100)
    stamps[50:] += 3.0
    stamps[80:] += 3.0
    assert gaps(stamps) == [50, 80]


def test_scans_two_seconds_apart_are_no_gaps() -> None:
    """A log of scans at key frames, by a slow robot: every motion would be doubted as one."""
    stamps = 2.0 * np.arange(60)
    assert gaps(stamps) == []
    stamps[40:] += 25.0
    assert gaps(stamps) == [40]


def test_scans_that_become_rarer_are_gaps_at_first_alone() -> None:
    stamps = np.cumsum(np.where(np.arange(100) < 50, 0.1, 2.0))
    assert gaps(stamps) == [50, 51]
