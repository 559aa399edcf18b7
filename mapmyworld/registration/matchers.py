"""One scan aligned with others, by the matcher that `registration.matcher` names."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.errors import ConfigError
from mapmyworld.registration.point_to_line import point_to_line
from mapmyworld.registration.scan_matching import FINE, Match, PreparedScan, ScanSet

Array = NDArray[np.float64]
_NO_PRIOR = np.zeros((3, 3))
Matcher = Callable[
    [
        PreparedScan,
        ScanSet,
        NDArray[np.int64],
        Array,
        Array,
        RegistrationConfig,
        Array,
        Array,
        Array,
    ],
    Match,
]
"""Takes scan, targets, which of them, their poses (S, 3), guess (3,), settings, prior (3,) and its
information (3, 3), and max correspondence distances [m], one a step. It keeps
the laws of its tests.
"""

MATCHERS: Mapping[str, Matcher] = {
    "point_to_line": point_to_line,
}


@functools.cache
def find_matcher(name: str) -> Matcher:
    """The matcher of that name; raises `ConfigError` with the names there are."""
    if name not in MATCHERS:
        raise ConfigError(f'registration.matcher is "{name}": choose one of {", ".join(MATCHERS)}')
    return MATCHERS[name]


def match_scan(
    scan: PreparedScan,
    targets: ScanSet,
    which: NDArray[np.int64],
    poses: Array,
    guess: Array,
    config: RegistrationConfig,
    *,
    prior: Array | None = None,
    prior_information: Array | None = None,
    max_distances: Array = FINE,
) -> Match:
    """Aligns a scan with targets `which` at `poses` (S, 3), from `guess` (3,), by the set matcher.

    `prior` (3,) with its information pulls as another measurement; the match's own information
    leaves it out.
    """
    prior = guess if prior is None else prior
    known = _NO_PRIOR if prior_information is None else prior_information
    match = find_matcher(config.matcher)
    return match(scan, targets, which, poses, guess, config, prior, known, max_distances)
