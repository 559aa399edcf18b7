"""`mapmyworld edit`: a person's statements about the graph, from a text file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from cli.arguments import PATH, map_and
from cli.config import config_options
from cli.progress import StderrProgress
from cli.standard_streams import end_partial
from mapmyworld.errors import MapError
from mapmyworld.types import Judged, Poses
from mapmyworld.types.wording import reason_of

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.types import MapStore

_MOST = 40  # changed constraints that are printed: one false statement may cost hundreds
_FIGHTING = 5  # strained constraints that are named


@click.command()
@click.argument("arguments", metavar="[MAP] EDITS.toml", nargs=-1, required=True, type=PATH)
@config_options
@click.option("--no-export", is_flag=True, help="Change MAP only, not the products beside it.")
def edit(arguments: tuple[Path, ...], config: Config, no_export: bool) -> None:
    """Accept, reject or add constraints of MAP, pin nodes, add priors; then optimise again.

    EDITS.toml replaces the edits that MAP has; an empty file undoes them. The next `build` of the
    same log into MAP replays them. `mapmyworld inspect graph` prints lines to paste. The grid,
    path, cloud and report that `build` wrote beside MAP are written again. Printed is every
    constraint that is accepted now and was not, or the other way round; the exit code is 3 where
    the rest of the graph contradicts what you state, or the map contradicts itself.

    \b
    [[reject]]                  # or [[accept]]; kind = "proximity" may be added
    from = 12
    to = 340
    reason = "two identical corridors"

    \b
    [[add]]                     # where node 250 is, seen from node 3
    from = 3
    to = 250
    pose = [1.2, 0.0, 90.0]     # m, m, degrees
    sigma = [0.05, 2.0]         # m, degrees
    reason = "measured with a tape"

    \b
    [[prior]]                   # the same of one node in the map
    node = 1
    pose = [0.0, 0.0, 0.0]
    sigma = [0.01, 0.5]
    reason = "the dock"

    \b
    [[pin]]                     # a node that stays: where it is, or at a pose
    node = 17
    reason = "surveyed"

    \b
    mapmyworld edit map.db edits.toml
    """
    from formats.database import open_store
    from formats.database.lock import only_writer
    from formats.edit_files import read_edits
    from mapmyworld.sensing.plan import moves_in_plane
    from mapmyworld.stages.replay_edits import edit_map

    map_path, edits_path = map_and(arguments, "EDITS.toml")
    edits = read_edits(Path(edits_path))
    progress = StderrProgress()
    with only_writer(map_path), open_store(map_path) as store:
        poses = store.poses()
        if poses is None:
            raise MapError(f"{map_path}: its graph is not solved yet: finish `build` first")
        before = Graph(store.constraints(), poses)
        losses = edit_map(store, edits, config, progress)
        written = [] if no_export else _renewed(store, map_path, config, progress)
        progress.finish()
        after, planar = Graph(store.constraints(), store.poses() or poses), moves_in_plane(store)
    click.echo("\n".join(account(before, after, len(edits))))
    for name in written:
        click.echo(f"written: {name}")
    for line in fight(before, after, planar):
        click.echo(line, err=True)
    end_partial(losses)


def _renewed(
    store: MapStore, map_path: Path, config: Config, progress: StderrProgress
) -> list[str]:
    """What lies beside the map, written again where `build` had: it showed the graph of before."""
    from cli.report import write_report
    from mapmyworld.exporting import export_beside

    written: list[str] = []
    page = map_path.with_suffix(".html")
    if any(map_path.with_suffix(ending).exists() for ending in (".pgm", ".tum", ".ply")):
        progress.stage("export")
        written += export_beside(store, map_path, config)
    if page.exists():
        progress.stage("report")
        write_report(store, page)
        written.append(str(page))
    return written


class Graph(NamedTuple):
    """A solved graph, before or after an edit."""

    constraints: Sequence[Judged]
    poses: Poses


def account(before: Graph, after: Graph, edits: int) -> list[str]:
    """The lines: a summary, then constraint by constraint what became of it."""
    from mapmyworld.graph.edited import changes, farthest_moved, name_of

    node, metres = farthest_moved(before.poses, after.poses)
    found = changes(before.constraints, after.constraints)
    old, new = (sum(c.accepted for c in graph.constraints) for graph in (before, after))
    lines = [
        f"{edits} edits applied: {old} -> {new} constraints accepted; "
        f"node {node} moved farthest, by {metres:.3f} m"
    ]
    lines += [
        f"  {c.what}: {name_of(c.constraint)}  {reason_of(c.constraint)}".rstrip()
        for c in found[:_MOST]
    ]
    if len(found) > _MOST:
        lines.append(f"  and {len(found) - _MOST} more: `mapmyworld inspect graph --all`")
    return lines


def fight(before: Graph, after: Graph, planar: bool) -> list[str]:
    """The constraints that were accepted without the edits and fit far worse with them."""
    from mapmyworld.graph.edited import in_sigmas, strained

    found = strained(before, after, planar)
    if not found:
        return []
    lines = [f"{len(found)} constraints contradict the edits; the largest residuals:"]
    return lines + [f"  {in_sigmas(one)}" for one in found[:_FIGHTING]]
