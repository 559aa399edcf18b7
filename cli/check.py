"""`mapmyworld check`: gates for scripts."""

from __future__ import annotations

import operator
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click

from cli.checking import KEYS, Sources, measure
from cli.common import EXIT_CHECK_FAILED, format_option, map_argument, show_json
from mapmyworld.errors import ConfigError

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_REQUIREMENT = re.compile(r"\s*(\w+)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*")


@dataclass(frozen=True, slots=True)
class Requirement:
    key: str
    symbol: str
    limit: float

    def holds(self, value: float) -> bool:
        return _OPERATORS[self.symbol](value, self.limit)

    def __str__(self) -> str:
        return f"{self.key} {self.symbol} {self.limit:g}"


@click.command()
@map_argument
@click.option("--require", "texts", multiple=True, metavar="'KEY OP VALUE'", help="A gate.")
@click.option("--reference", type=click.Path(path_type=Path), help="True trajectory: MAP or TUM.")
@click.option("--relations", type=click.Path(path_type=Path), help="A relations file.")
@click.option("--grid", type=click.Path(path_type=Path), help="YAML of the true grid.")
@click.option("--keys", "listing", is_flag=True, help="Print what can be required.")
@format_option
def check(
    map_path: Path,
    texts: tuple[str, ...],
    reference: Path | None,
    relations: Path | None,
    grid: Path | None,
    listing: bool,
    style: str,
) -> None:
    """Say whether MAP meets every requirement; exit code 4 when one fails.

    \b
    mapmyworld check map.db --require 'loop_closures >= 5' --require 'unknown_share < 0.6'
    mapmyworld check map.db --reference truth.tum --require 'ate_rmse <= 0.1'
    """
    if listing:
        _list_keys(style)
        return
    requirements = read_requirements(texts)
    wanted = {r.key for r in requirements}
    values = measure(wanted, Sources(map_path, reference, relations, grid))
    results = [(r, values[r.key], r.holds(values[r.key])) for r in requirements]
    if style == "json":
        show_json(
            {
                "passed": all(ok for _, _, ok in results),
                "requirements": [
                    {"require": str(r), "value": _finite(value), "passed": ok}
                    for r, value, ok in results
                ],
            }
        )
    else:
        for requirement, value, ok in results:
            click.echo(f"{'ok' if ok else 'FAILED':8}{requirement}  (is {value:g})")
    if not all(ok for _, _, ok in results):
        sys.exit(EXIT_CHECK_FAILED)


def read_requirements(texts: tuple[str, ...]) -> list[Requirement]:
    """All requirements; raises `ConfigError` with everything that is not understood."""
    found, problems = [], []
    for text in texts:
        match = _REQUIREMENT.fullmatch(text)
        limit = _number(match[3]) if match else None
        if match is None or limit is None:
            problems.append(f"{text!r}: write KEY OP VALUE, e.g. 'loop_closures >= 5'")
        elif match[1] not in KEYS:
            problems.append(f"there is no key {match[1]!r}: choose one of {', '.join(KEYS)}")
        else:
            found.append(Requirement(match[1], match[2], limit))
    if not texts:
        problems.append("nothing is required: give --require 'KEY OP VALUE'")
    if problems:
        raise ConfigError("the check cannot be made:", problems=problems)
    return found


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return None if number != number else number


def _finite(value: float) -> float | None:
    return value if abs(value) != float("inf") and value == value else None


def _list_keys(style: str) -> None:
    if style == "json":
        show_json({name: key.about for name, key in KEYS.items()})
        return
    for name, key in KEYS.items():
        click.echo(f"{name:22}{key.about}")
