"""Settings of the back end."""

from __future__ import annotations

from dataclasses import dataclass

from mapmyworld.config.ranges import Count, Positive, Probability


@dataclass(frozen=True, slots=True)
class GraphConfig:
    """Settings of optimisation and of believing closures."""

    iterations: Count = 300  # steps of Levenberg-Marquardt at most, per start
    tolerance: Positive = 1e-7  # relative decrease of the cost below which a solution stands
    robust: bool = True  # whether closures that contradict odometry and each other are rejected
    inlier_probability: Probability = 0.9999  # of a true constraint to pass a chi-square test
    consistency_probability: Probability = 0.999  # of two true closures to pass for consistent
    groups: bool = True  # whether closures that agree among themselves must fit the rest as well
    covariances: bool = True  # whether the uncertainty of every node is computed
    certify: bool = True  # whether it is proven, where possible, that the minimum is global
