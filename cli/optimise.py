"""`mapmyworld optimise`: the back end alone, on a graph file or a map."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import PATH, format_option
from cli.config import config_options
from cli.manners import note
from cli.outputs import (
    require_no_other,
    require_no_other_log,
    require_output_name,
    require_outputs,
)
from cli.standard_streams import end_partial, show_result
from mapmyworld.errors import GraphError
from mapmyworld.types import Poses

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.graph.optimisation import OptimisedGraph
    from mapmyworld.types.pose_graph import PoseGraph

_SHOWN = ("cost", "start", "start_costs", "reached", "iterations", "converged", "certainty")


@click.command()
@click.argument("path", metavar="FILE", type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="The optimised graph: .g2o, or .db for a map.  [default: FILE's name with "
    "_optimised.g2o, in the current folder]",
)
@click.option("--robust", is_flag=True, help="Reject closures that contradict the rest.")
@click.option("--image", type=PATH, help="Draw the result into this PNG.")
@config_options
@format_option
def optimise(
    path: Path,
    output: Path | None,
    robust: bool,
    image: Path | None,
    config: Config,
) -> None:
    """Optimise the pose graph in FILE: g2o, TORO, GTSAM text, map.db or an RTAB-Map database.

    Stored vertices are not needed: the start is found from the edges. Edges between consecutive
    nodes count as odometry, which --robust believes. What cannot be used is named on stderr, the
    rest is optimised, and the exit code is 3.

    \b
    mapmyworld optimise manhattan.g2o -o solved.g2o
    mapmyworld optimise map.db --robust --format json
    mapmyworld optimise sphere.g2o -o sphere.db
    """
    require_output_name(path)
    output = output or Path(f"{path.stem}_optimised.g2o")
    _require_place(output, path)
    require_outputs([image], [path, output])
    import formats.graph_reading  # noqa: F401  so that its import does not count as reading

    started = time.perf_counter()
    graph, problems, notes = load_graph(path)
    seconds = {"read": time.perf_counter() - started}
    if len(graph) == 0:
        why = problems[0] if problems else "nothing to optimise"
        raise GraphError(f"{path}: the graph has no nodes: {why}")
    started = time.perf_counter()
    from mapmyworld.graph.optimisation import optimise as optimise_graph
    from mapmyworld.graph.optimisation import optimise_robustly
    from mapmyworld.graph.solved_graph import component_losses

    seconds["import"] = time.perf_counter() - started
    started = time.perf_counter()
    solved = (optimise_robustly if robust else optimise_graph)(graph, config.graph)
    seconds["optimise"] = time.perf_counter() - started
    facts = {"file": str(path), **_facts(graph, solved)}
    losses = [*problems, *component_losses(facts["components"])]
    _write(output, path, graph, solved, losses)
    facts |= {
        "problems": problems,
        "notes": notes,
        "seconds": seconds,
        "output": str(output),
    }
    if image is not None:
        draw(image, solved)
    show_result(facts, _lines(facts))
    end_partial([f"{path}: {loss}" for loss in losses])


def _require_place(output: Path, path: Path) -> None:
    """Refuses what it would not write, and to replace the graph itself or anything else."""
    require_outputs([output], [path])
    if output.suffix == ".db":
        require_no_other(output)
        require_no_other_log(output, path)
    elif output.suffix != ".g2o":
        raise click.UsageError(f"{output}: give a name that ends in .g2o, or in .db for a map")


def _facts(graph: PoseGraph, solved: OptimisedGraph) -> dict[str, Any]:
    ends = zip(graph.edges.from_ids, graph.edges.to_ids, solved.accepted, strict=True)
    return {
        "nodes": len(graph),
        "edges": len(graph.edges),
        "landmarks": len(graph.landmark_ids),
        **{name: getattr(solved, name) for name in _SHOWN},
        "certificate": None if solved.certificate is None else asdict(solved.certificate),
        "components": int(solved.component.max()) + 1,
        "rejected": [[int(a), int(b)] for a, b, good in ends if not good],
    }


def _write(
    output: Path, path: Path, graph: PoseGraph, solved: OptimisedGraph, losses: list[str]
) -> None:
    """The solved graph of `path` as a map or as g2o, as the name's ending says."""
    if output.suffix == ".db":
        from cli.optimise_map import write_map
        from formats.database.lock import only_writer
        from formats.whole_files import whole_path

        with only_writer(output), whole_path(output) as part:
            write_map(part, path, graph, solved, losses)
    else:
        from formats.graph_files import write_graph

        write_graph(output, solved.graph)


def load_graph(path: Path) -> tuple[PoseGraph, list[str], list[str]]:
    """The graph of a text file or of a map, its problems, and its notes."""
    from formats.database.connection import is_sqlite
    from formats.graph_reading import read_graph

    if path.is_file() and is_sqlite(path):
        return _graph_of_map(path), [], []
    read = read_graph(path)
    return read.graph, list(read.problems), list(read.notes)


def _graph_of_map(path: Path) -> PoseGraph:
    import numpy as np

    from formats.database import open_store
    from mapmyworld.geometry.rigid import invert
    from mapmyworld.graph.canonical_graph import graph_from_constraints

    with open_store(path, read_only=True) as store:
        nodes, constraints, plan = store.nodes(), store.constraints(), store.get("plan") or {}
        poses = store.poses()
    ids = np.array([node.id for node in nodes], np.int64)
    start = np.array([node.tracked_from_base for node in nodes]).reshape(-1, 4, 4)
    if poses is not None:
        first = poses.map_from_node[poses.ids == ids[0]]
        if len(first) and not np.array_equal(first[0], start[0]):  # the map was made level
            start = first[0] @ invert(start[0]) @ start
        extra = poses.ids < 0
        ids = np.concatenate([ids, poses.ids[extra]])
        start = np.concatenate([start, poses.map_from_node[extra]])
    return graph_from_constraints(ids, start, constraints, bool(plan.get("planar", False)))


def draw(image: Path, solved: OptimisedGraph) -> None:
    """The solved graph as a picture."""
    from cli.optimise_map import constraints_of, matrices_of
    from formats.report.map_pictures import write_graph_picture

    graph = solved.graph
    landmarks = graph.landmarks if len(graph.landmark_ids) else None
    poses = Poses(graph.ids, matrices_of(graph.planar, graph.map_from_node))
    write_graph_picture(image, poses, constraints_of(solved), None, landmarks)
    note(f"drew {image}")


def _lines(facts: dict[str, Any]) -> list[str]:
    reached = facts["reached"]
    starts = ", ".join(
        f"{name} {cost:.6g}" + (f" -> {reached[name]:.6g}" if name in reached else "")
        for name, cost in facts["start_costs"].items()
    )
    if "wraparound" in reached:
        starts += f", wraparound -> {reached['wraparound']:.6g}"
    seconds = facts["seconds"]
    lines = [
        f"graph       {facts['nodes']} nodes, {facts['edges']} edges, "
        f"{facts['landmarks']} landmarks",
        f"cost        {facts['cost']:.8g} (half the sum of squared sigmas)",
        f"starts      {starts}; the best is {facts['start']}",
        f"steps       {facts['iterations']}{'' if facts['converged'] else ', not converged'}",
        f"certainty   {facts['certainty']}",
        f"time        read {seconds['read']:.3f} s, optimise {seconds['optimise']:.3f} s",
        f"written     {facts['output']}",
    ]
    if facts["components"] > 1:
        lines.insert(
            1, f"connected   NO: {facts['components']} components, each with its own anchor"
        )
    if facts["rejected"]:
        shown = ", ".join(f"{a}-{b}" for a, b in facts["rejected"][:10])
        more = ", ..." if len(facts["rejected"]) > 10 else ""
        lines.append(f"rejected    {len(facts['rejected'])} edges: {shown}{more}")
    return lines + [f"note        {note}" for note in facts["notes"]]
