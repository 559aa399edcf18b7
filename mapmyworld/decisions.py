"""What is decided on the way, a line each, to whoever listens: the standard library's logging.

Nobody does unless asked (`--debug FILE`, or a handler on the logger `mapmyworld`): what is worded
often, as for each frame, is worded only where `is_heard`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable

from mapmyworld.types.constraints import Judged
from mapmyworld.types.wording import reason_of

LOGGER = logging.getLogger("mapmyworld")
LOGGER.addHandler(logging.NullHandler())  # else logging's own last resort would print


def is_heard() -> bool:
    """Whether anybody listens: before costly words."""
    return LOGGER.isEnabledFor(logging.DEBUG)


def decided(topic: str, text: str) -> None:
    """One decision, under a word by which lines are found."""
    if is_heard():
        LOGGER.debug("%s", text, extra={"topic": topic})


def decided_on(topic: str, constraints: Iterable[Judged]) -> None:
    """What became of constraints, and why."""
    if not is_heard():
        return
    for c in constraints:
        state = "accepted" if c.accepted else "rejected"
        decided(topic, f"{c.kind} {c.from_id} and {c.to_id} {state}: {reason_of(c)}")
