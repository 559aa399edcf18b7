"""Inertial samples come with the frames that a camera tracks, and are left alone else."""

from __future__ import annotations

import numpy as np
from messages_in_memory import MemoryLog, scan_at, transform

from mapmyworld.config import SensingConfig
from mapmyworld.sensing import make_plan, read_frames, survey_log
from mapmyworld.stages.trackers import needs_inertial
from mapmyworld.types import ImuMessage, Message

MS = 1_000_000


def test_samples_are_not_decoded_where_no_tracker_asks_for_them() -> None:
    still = np.zeros(3)
    entries: list[tuple[str, Message, int]] = [
        ("/tf_static", transform("base_link", "laser", (0, 0, 0)), 0)
    ]
    entries += [("/scan", scan_at(t * MS), t * MS) for t in range(20, 900, 100)]
    entries += [
        ("/imu", ImuMessage(t * MS, "base_link", None, still, still), t * MS)
        for t in range(0, 900, 10)
    ]
    log = MemoryLog(entries)
    plan = make_plan(survey_log(log), SensingConfig())
    assert plan.imu is not None
    assert not needs_inertial(plan)
    seen = list(read_frames(log, plan, SensingConfig()))
    assert sum(len(frame.imu) for frame in seen) > 50
    unseen = list(read_frames(log, plan, SensingConfig(), inertial=False))
    assert [frame.stamp_ns for frame in unseen] == [frame.stamp_ns for frame in seen]
    assert not any(frame.imu for frame in unseen)
