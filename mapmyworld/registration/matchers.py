"""Who aligns laser scans: matchers by the names that `registration.matcher` takes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

from mapmyworld.errors import ConfigError
from mapmyworld.registration.point_to_line import point_to_line
from mapmyworld.registration.scan_matching import Match

Matcher = Callable[..., Match]
"""Takes what `match_scan` takes, by position, and keeps the laws of its tests."""

MATCHERS: Mapping[str, Matcher] = {
    "point_to_line": point_to_line,
}


@functools.cache
def find_matcher(name: str) -> Matcher:
    """The matcher of that name; raises `ConfigError` with the names there are."""
    if name not in MATCHERS:
        raise ConfigError(f'registration.matcher is "{name}": choose one of {", ".join(MATCHERS)}')
    return MATCHERS[name]
