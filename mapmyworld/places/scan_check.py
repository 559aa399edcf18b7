"""Closures by images measured once more by the laser scans of both nodes, where there are some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import (
    between_planar,
    information_from_planar,
    information_to_planar,
    matrix_to_planar,
    planar_to_matrix,
)
from mapmyworld.registration.image_pairs import ImagePair
from mapmyworld.registration.matchers import match_scan
from mapmyworld.registration.scan_matching import Match, prepare_scans
from mapmyworld.types import Judge, Registration, Scan, Verdict, Why

Array = NDArray[np.float64]
_ONLY = np.zeros(1, np.int64)
_ORIGIN = np.zeros((1, 3))
_FLOOR = np.array([0.005, 0.005, 0.002])  # m, m, rad: no pair of scans is more certain


def refine_by_scans(pair: ImagePair, earlier: Scan, later: Scan, config: Config) -> ImagePair:
    """The pair with its motion aligned by both scans (ICP point to line), images as the prior.

    Where the scans overlap too little, it stays as it is. Where they agree on a motion that
    the images exclude, it is no closure.
    """
    found = pair.registration
    guess, prior = matrix_to_planar(found.a_from_b), information_to_planar(found.information)
    scans = prepare_scans([earlier, later], config.registration)
    match = match_scan(
        scans.one(1), scans, _ONLY, _ORIGIN, guess, config.registration,
        prior=guess, prior_information=prior,
    )  # fmt: skip
    if match.overlap < config.visual.closure_scan_overlap:
        return pair
    miss = between_planar(guess, match.pose)
    sigmas = float(np.sqrt(miss @ np.linalg.inv(np.linalg.inv(prior) + np.diag(_FLOOR**2)) @ miss))
    if sigmas > config.visual.closure_gate:
        verdict = Verdict(Judge.LASER, False, Why.SCANS_CONTRADICT, {"sigmas": sigmas})
        return replace(pair, registration=replace(found, verdict=verdict))
    return replace(pair, registration=_refined(found, match))


def _refined(found: Registration, match: Match) -> Registration:
    """The motion in the plane by the scans, the rest of it by the images."""
    flat = planar_to_matrix(matrix_to_planar(found.a_from_b))
    rest = np.linalg.inv(flat) @ found.a_from_b
    reported = np.linalg.inv(
        np.linalg.inv(match.information + 1e-6 * np.eye(3)) + np.diag(_FLOOR**2)
    )
    numbers = {**found.verdict.numbers, "overlap": float(match.overlap)}
    return replace(
        found,
        a_from_b=planar_to_matrix(match.pose) @ rest,
        information=found.information + information_from_planar(reported, off_plane=0.0),
        verdict=Verdict(Judge.LASER, True, Why.IMAGES_AND_SCANS_AGREE, numbers),
    )
