"""The part of the plan that takes the user at his word: topics that he names and the log lacks."""

from __future__ import annotations

import difflib
from collections.abc import Iterator

from mapmyworld.errors import ConfigError
from mapmyworld.sensing.plan import Draft
from mapmyworld.types import MessageKind

_IMAGES = {MessageKind.IMAGE}
# Setting -> kinds of topics that it may name, and what they are called.
_ROLES = {
    "scan_topic": ({MessageKind.LASER_SCAN, MessageKind.POINT_CLOUD}, "scans"),
    "odometry_topic": ({MessageKind.ODOMETRY}, "odometry"),
    "colour_topic": (_IMAGES, "images"),
    "depth_topic": (_IMAGES, "images"),
    "camera_info_topic": ({MessageKind.CAMERA_INFO}, "camera infos"),
}


def check_topics(draft: Draft) -> None:
    """Raises `ConfigError` with every topic that is set and of which the log holds no message."""
    problems = list(_problems(draft))
    if problems:
        raise ConfigError("topics are set that the log does not have:", problems=problems)


def _problems(draft: Draft) -> Iterator[str]:
    for name, (kinds, plural) in _ROLES.items():
        wanted = getattr(draft.config, name)
        known = sorted(s.topic for kind in kinds for s in draft.survey.of_kind(kind))
        no_topic = name == "odometry_topic" and (wanted == "none" or wanted.startswith("tf"))
        if not wanted or no_topic or wanted in known:
            continue
        near = difflib.get_close_matches(wanted, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        yield (
            f"sensing.{name} = {wanted!r} is not in the log; {plural}: "
            f"{', '.join(known) or 'none'}{hint}"
        )
