"""Requirements on figures: read, judged, and compared with an older map."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cli.arguments import british
from cli.checking import BETTER, KEYS
from formats.check_results import Verdict
from mapmyworld.errors import ConfigError

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_REQUIREMENT = re.compile(r"\s*([\w.]+)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*")
WHOLE = "whole"  # the requirement that every map must meet


@dataclass(frozen=True, slots=True)
class Requirement:
    """A limit that a figure has to keep: `ate<0.1`."""

    key: str
    symbol: str
    limit: float

    def __str__(self) -> str:
        return f"{self.key} {self.symbol} {self.limit:g}"


def read_requirements(texts: Sequence[str]) -> list[Requirement]:
    """All requirements; raises `ConfigError` with everything that is not understood."""
    found, problems = [], []
    for text in texts:
        match = _REQUIREMENT.fullmatch(british(text))
        limit = _number(match[3]) if match else None
        if match is None or limit is None:
            problems.append(f"{text!r}: write KEY OP VALUE, e.g. 'loop_closures >= 5'")
        elif match[1] not in KEYS and "." not in match[1]:
            problems.append(f"there is no key {match[1]!r}: choose one of {', '.join(KEYS)}")
        else:
            found.append(Requirement(match[1], match[2], limit))
    if problems:
        raise ConfigError("the check cannot be made:", problems=problems)
    return found


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return None if math.isnan(number) else number


def judged(requirement: Requirement, value: float) -> Verdict:
    """The verdict; of a limit that is missed what was measured, and by how much it misses."""
    passed = _OPERATORS[requirement.symbol](value, requirement.limit)
    key = KEYS.get(requirement.key)
    message = f"is {value:g}" + (f", {key.about}" if key and not passed else "")
    if not passed:
        message += f"; misses {requirement.limit:g} by {abs(value - requirement.limit):.6g}"
    return Verdict(requirement.key, str(requirement), value, passed, message)


def wholeness(problems: Sequence[str]) -> Verdict:
    """A map that lost something does not pass as a whole one."""
    message = "nothing was lost" if not problems else "partial: " + "; ".join(problems)
    return Verdict(WHOLE, WHOLE, float(not problems), not problems, message)


def no_worse(new: Mapping[str, float], old: Mapping[str, float], tolerance: float) -> list[Verdict]:
    """Every figure that has a better and a worse, against an older map's, within a share."""
    verdicts = []
    for key, better in BETTER.items():
        if key not in new or key not in old:
            continue
        limit = old[key] - better * tolerance * abs(old[key])
        requirement = Requirement(key, ">=" if better > 0 else "<=", limit)
        verdict = judged(requirement, new[key])
        message = f"{verdict.message} (baseline {old[key]:g})"
        verdicts.append(Verdict(key, str(requirement), new[key], verdict.passed, message))
    return verdicts
