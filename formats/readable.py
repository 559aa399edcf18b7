"""Text of unknown origin as a terminal, a CI's record or a page may have it: no commands in it."""

from __future__ import annotations

import re

_LONGEST = 160  # characters of a name in a table
_CONTROLS = re.compile(
    # All but tab and line feed; what turns the direction of writing; other ends of lines.
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]"
)


def readable(text: str) -> str:
    """The text with control characters written out, as \\x1b: none moves, colours or reorders."""
    return _CONTROLS.sub(lambda m: m.group().encode("unicode_escape").decode("ascii"), text)


def one_line(name: str) -> str:
    """A name for a table: readable, without line ends, its middle left out where it is long."""
    line = readable(name).replace("\n", "\\n").replace("\t", "\\t")
    if len(line) <= _LONGEST:
        return line
    left = len(line) - _LONGEST
    half = _LONGEST // 2
    return f"{line[:half]}...({left} more)...{line[-half:]}"
