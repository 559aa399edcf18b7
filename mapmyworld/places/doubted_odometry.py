"""Odometry that scans put in doubt: what a fault adds to what a motion was measured to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import information_from_planar, information_to_planar
from mapmyworld.odometry.pose_hypotheses import FAULT_SIZE
from mapmyworld.types import Judged, LaserTracking, Source


def in_doubt(c: Judged, doubted: bool) -> Judged:
    """The same motion, which may be a fault; or no more, where it was in doubt."""
    assert isinstance(c.source, LaserTracking)
    measured, fault = np.linalg.inv(information_to_planar(c.information)), np.square(FAULT_SIZE)
    covariance = measured + np.diag(fault if doubted else -fault)
    return measured_anew(c, c.i_from_j, covariance, replace(c.source, doubted=doubted))


def measured_anew(c: Judged, motion: Array, covariance: Array, source: Source) -> Judged:
    """A constraint of the same kind between the same nodes, by another measurement.

    Of the `motion` (4, 4), with a planar `covariance` (3, 3).
    """
    information = information_from_planar(np.linalg.inv(covariance))
    return Judged(c.from_id, c.to_id, c.kind, motion, information, source)
