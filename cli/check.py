"""`mapmyworld check`: gates for scripts."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from cli.arguments import PATH, FiniteRange, format_option, map_argument, wants_json
from cli.checking import BETTER, KEYS, Facts, measure
from cli.completion import keys_from
from cli.exit_codes import EXIT_CHECK_FAILED
from cli.figure_names import figures_of, problems_of
from cli.gates import WHOLE, judged, no_worse, read_requirements, wholeness
from cli.outputs import require_apart
from cli.scoring import few_relations
from cli.standard_streams import end_partial, own_words, show_result
from formats.check_results import Verdict, junit_xml, markdown
from formats.database import open_store
from formats.readable import readable
from formats.whole_files import utf8_of
from mapmyworld.errors import ConfigError


@click.command()
@map_argument
@click.option(
    "--require",
    "texts",
    multiple=True,
    metavar="'KEY OP VALUE'",
    shell_complete=keys_from,
    help="What must hold, e.g. 'nodes >= 10'. May be repeated.",
)
@click.option("--baseline", type=PATH, metavar="OLD", help="No figure may be worse than OLD's.")
@click.option(
    "--tolerance",
    type=FiniteRange(min=0.0),
    default=0.05,
    help="Share of OLD's figures by which MAP's may be worse.",
)
@click.option("--allow-partial", is_flag=True, help="Accept a partial map.")
@click.option("--reference", type=PATH, help="True trajectory, a TUM file or a MAP.")
@click.option("--relations", type=PATH, help="Known relative poses.")
@click.option("--grid", type=PATH, help="YAML of the true grid.")
@click.option("--junit", type=PATH, metavar="FILE", help="Write the verdicts as JUnit XML.")
@click.option(
    "--markdown", "comment", type=PATH, metavar="FILE", help="Write the verdicts as Markdown."
)
@click.option("--keys", "listing", is_flag=True, help="Print what can be required.")
@format_option
def check(
    map_path: Path,
    texts: tuple[str, ...],
    baseline: Path | None,
    tolerance: float,
    allow_partial: bool,
    reference: Path | None,
    relations: Path | None,
    grid: Path | None,
    junit: Path | None,
    comment: Path | None,
    listing: bool,
) -> None:
    """Say whether MAP meets every requirement; exit code 4 when one fails.

    A KEY is one that --keys lists, or the dotted name of a figure that `inspect map` or
    `inspect graph` prints as JSON. A map that lost something fails, unless --allow-partial. Where
    most of the relations lie outside MAP's time, the exit code of a check that passes is 3.

    \b
    mapmyworld check map.db --require 'loop_closures >= 5' --require 'unknown_share < 0.6'
    mapmyworld check map.db --require 'graph.constraints.proximity.accepted >= 3'
    mapmyworld check map.db --reference truth.tum --require 'ate_rmse <= 0.1'
    mapmyworld check map.db --baseline last_week.db --junit check.xml
    """
    for output in filter(None, (junit, comment)):
        require_apart(output, [map_path, baseline, reference, relations, grid])
    if listing:
        _list_keys(map_path)
        return
    if not texts and baseline is None:
        raise ConfigError("nothing is required: give --require 'KEY OP VALUE' or --baseline OLD")
    with open_store(map_path, read_only=True) as store:
        given = {"reference": reference, "relations": relations, "grid": grid}
        facts = Facts(store, map_path, {k: path for k, path in given.items() if path is not None})
        verdicts = _verdicts(facts, texts, baseline, tolerance, allow_partial)
        name = utf8_of(map_path.name).decode()
        for path, form in ((junit, junit_xml), (comment, markdown)):
            if path is not None:
                path.write_text(form(name, verdicts), encoding="utf-8")
        _show(verdicts)
        if not all(verdict.passed for verdict in verdicts):
            sys.exit(EXIT_CHECK_FAILED)
        few = [] if relations is None else few_relations(facts.related)
    if not allow_partial:
        end_partial(few)
    for line in few:
        click.echo(f"mapmyworld: {line}", err=True)


def _verdicts(
    facts: Facts,
    texts: Sequence[str],
    baseline: Path | None,
    tolerance: float,
    allow_partial: bool,
) -> list[Verdict]:
    requirements = read_requirements(texts)
    verdicts = [] if allow_partial else [wholeness(problems_of(facts.store))]
    values = measure({r.key for r in requirements}, facts)
    verdicts += [judged(r, values[r.key]) for r in requirements]
    if baseline is not None:
        with open_store(baseline, read_only=True) as store:
            old = Facts(store, baseline, facts.files)
            verdicts += no_worse(_comparable(facts), _comparable(old), tolerance)
    return verdicts


def _comparable(facts: Facts) -> dict[str, float]:
    """The figures that have a better and a worse, as far as this map has them."""
    found: dict[str, float] = {}
    for key in BETTER:
        if (needs := KEYS[key].needs) and needs not in facts.files:
            continue
        try:
            found |= measure({key}, facts)
        except ConfigError:
            continue  # a map without a grid has no unknown cells to compare
    return found


def _show(verdicts: Sequence[Verdict]) -> None:
    if wants_json():
        rows = [
            {
                "require": v.requirement,
                "value": _finite(v.value),
                "passed": v.passed,
                "message": v.message,
            }
            for v in verdicts
            if v.name != WHOLE
        ]
        passed = all(v.passed for v in verdicts)
        whole = [v.message for v in verdicts if v.name == WHOLE and not v.passed]
        show_result({"passed": passed, "partial": whole, "requirements": rows}, ())
        return
    for v in verdicts:
        word = click.style("ok", fg="green") if v.passed else click.style("FAILED", fg="red")
        pad = " " * (8 - len("ok" if v.passed else "FAILED"))
        reported = readable(f"{v.requirement}  ({v.message})")
        click.echo(f"{word}{pad}{reported}", file=own_words(sys.stdout))


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _list_keys(map_path: Path) -> None:
    """The short names with what they mean; then every figure of MAP, where there is one."""
    figures: dict[str, float] = {}
    if map_path.exists():
        with open_store(map_path, read_only=True) as store:
            figures = figures_of(store)
    meanings = {name: key.about for name, key in KEYS.items()}
    lines = [f"{name:22}{about}" for name, about in meanings.items()]
    lines += [f"{name:48}{value:g}" for name, value in figures.items()]
    show_result(meanings | figures, lines)
