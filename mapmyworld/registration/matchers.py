"""Who aligns laser scans: matchers by the names that `registration.matcher` takes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.errors import ConfigError
from mapmyworld.registration.point_to_line import point_to_line
from mapmyworld.registration.scan_matching import Match, PreparedScan, ScanSet

Array = NDArray[np.float64]
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
information (3, 3), and reaches: metres within which lines are looked for, one a step. It keeps
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
