"""How two poses of a later place are compared by what scans and drift indicate."""

from __future__ import annotations

import numpy as np
import pytest

from mapmyworld.geometry import Index
from mapmyworld.registration.place_evidence import Agreement, Hypothesis
from mapmyworld.registration.submaps import MARGIN

POINTS = 140


def seen(agree: int, contradict: int) -> Index:
    """(P,) points of a place: so many that agree, then some that contradict, the rest unseen."""
    found = np.zeros(POINTS, np.int64)
    found[:agree] = 1
    found[agree : agree + contradict] = -1
    return found


def hypothesis(forth: tuple[int, int], back: tuple[int, int], prior: float = 0.0) -> Hypothesis:
    """A pose of which points of the later place, and of the earlier one, show so much."""
    return Hypothesis(Agreement(seen(*forth), seen(*back)), prior)


@pytest.mark.parametrize("size", [1, 3])
def test_no_pose_is_clear_while_another_has_more_evidence(size: int) -> None:
    """A corner a corridor's width off contradicts less than the true one, whose submap is bent."""
    wrong, true = hypothesis((65, 0), (64, 1)), hypothesis((82, 4), (103, 40))
    assert true.agreement.evidence > wrong.agreement.evidence
    assert wrong.agreement.beyond(true.agreement) > MARGIN
    assert wrong.beyond(true, size) < size * MARGIN


def test_what_surpasses_in_all_is_clear_and_so_is_what_drift_decides() -> None:
    best, other = hypothesis((90, 0), (90, 2)), hypothesis((40, 30), (40, 30))
    assert best.beyond(other) == best.agreement.beyond(other.agreement) > MARGIN
    alike = hypothesis((80, 4), (80, 4)), hypothesis((80, 4), (80, 4), prior=-40.0)
    assert alike[0].beyond(alike[1]) > MARGIN
    assert alike[1].beyond(alike[0]) < -MARGIN
