"""`mapmyworld inspect graph`: constraints tried, accepted and rejected, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from cli.arguments import PATH, format_option, map_argument
from cli.manners import note
from cli.outputs import require_outputs
from cli.standard_streams import show_result
from formats.database import open_store
from mapmyworld.errors import MapError
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.types import OF_ONE_NODE, ConstraintKind, Judged, MapStore, Poses
from mapmyworld.types.wording import in_words, name_of_ends, reason_of

_LEVEL = 0.005  # deg: a turn about the vertical alone


@click.command()
@map_argument
@format_option
@click.option("--image", type=PATH, help="Draw the graph into this PNG.")
@click.option(
    "--pair",
    type=(int, int),
    metavar="A B",
    help="With --image: the images of nodes A and B with what matches between them.",
)
@click.option(
    "--between",
    type=(int, int),
    metavar="A B",
    help="The pose of node B seen from node A, and how confident it is.",
)
@click.option(
    "--worst", type=click.IntRange(0), default=10,
    help="How many constraints of each list to show.",
)  # fmt: skip
@click.option("--all", "everything", is_flag=True, help="List every rejected constraint.")
def graph(
    map_path: Path,
    image: Path | None,
    pair: tuple[int, int] | None,
    between: tuple[int, int] | None,
    worst: int,
    everything: bool,
) -> None:
    """Nodes and constraints of MAP: tried, accepted, rejected and why; residuals; connectivity.

    Lines that begin with [[ can be pasted into a file for `mapmyworld edit`.

    \b
    mapmyworld inspect graph
    mapmyworld inspect graph office.db --image graph.png
    mapmyworld inspect graph office.db --pair 3 17 --image pair.png
    mapmyworld inspect graph office.db --between 3 17
    """
    require_outputs([image], [map_path])
    if pair is not None:
        if image is None:
            raise click.UsageError("--pair draws a picture: say where with --image FILE")
        _draw_pair(map_path, pair, image)
        return

    with open_store(map_path, read_only=True) as store:
        poses = store.poses()
        if poses is None:
            raise MapError(
                f"{map_path}: its graph is not solved yet: finish `mapmyworld build` first"
            )
        facts = facts_of_map(store, poses, None if everything else worst, worst)
        if between is not None:
            facts["between"] = _relative(store, *between)
        if image is not None:
            from formats.report.map_pictures import write_graph_picture

            write_graph_picture(image, poses, store.constraints(), store.grid())
            note(f"drew {image}")
    show_result(facts, _lines(facts))


def _draw_pair(map_path: Path, pair: tuple[int, int], path: Path) -> None:
    """Both images with their matches."""
    import numpy as np

    from formats.report.match_picture import write_match_picture
    from mapmyworld.config import Config
    from mapmyworld.places.node_pairs import compare_nodes

    with open_store(map_path, read_only=True) as store:
        found = compare_nodes(store, *pair, Config())
    matches, registration = found.pair, found.pair.registration
    reason = in_words(registration.verdict)
    a, b = (np.asarray(image.pixels(), np.uint8) for image in (found.colour_a, found.colour_b))
    write_match_picture(
        path,
        (a, b),
        found.features_a.pixels[matches.features_a],
        found.features_b.pixels[matches.features_b],
        matches.agreed,
        reason,
    )
    verdict = "fits" if registration.verdict.accepted else "does not fit"
    click.echo(f"{pair[0]} and {pair[1]}: {verdict}: {reason}")
    note(f"drew {path}")


def _relative(store: MapStore, from_id: int, to_id: int) -> dict[str, Any]:
    """The relative pose of two nodes and its uncertainty, from the accepted constraints."""
    import numpy as np

    from mapmyworld.exporting import graph_of
    from mapmyworld.geometry.rotations import rotation_angle, rotation_to_roll_pitch_yaw
    from mapmyworld.graph.covariance import relative_pose
    from mapmyworld.map_figures import scan_noise_of

    motion, covariance = relative_pose(graph_of(store), from_id, to_id, scan_noise_of(store))
    in_from = motion[:3, :3] @ covariance[3:, 3:] @ motion[:3, :3].T  # along the axes of xyz
    return {
        "from": from_id,
        "to": to_id,
        "xyz": motion[:3, 3].tolist(),
        "degrees": float(np.degrees(rotation_angle(motion))),
        "roll_pitch_yaw": np.degrees(rotation_to_roll_pitch_yaw(motion[:3, :3])).tolist(),
        "sigma_metres": float(np.sqrt(np.trace(covariance[3:, 3:]))),
        "sigmas_xyz": np.sqrt(np.diag(in_from)).tolist(),
        "sigma_degrees": float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        "covariance": covariance.tolist(),
    }


def facts_of_map(
    store: MapStore, poses: Poses, rejected_shown: int | None, worst: int
) -> dict[str, Any]:
    """What `inspect graph` shows of a map, but for what it is asked about single nodes.

    Normalised residuals are those of covariances scaled by the variance factors, all others those
    that were stated, as verdicts have them.
    """
    from mapmyworld import map_figures as figures
    from mapmyworld.graph import audit
    from mapmyworld.graph.variance import normalised_residuals

    constraints, planar, solved = store.constraints(), moves_in_plane(store), store.get("solve")
    residuals = audit.residuals_against(constraints, poses, planar)
    known = [m for m in residuals if m is not None]
    accepted = sorted((m for m in known if m.constraint.accepted), key=lambda m: -m.sigmas)
    rejected = [(c, m) for c, m in zip(constraints, residuals, strict=True) if not c.accepted]
    factors = figures.variance_factors_of(store)
    residual = normalised_residuals(figures.calibrated(constraints, factors), poses, planar)
    corrections = audit.corrections_of(residuals, figures.tracked_poses(store.nodes()))
    parts = figures.components_of(constraints, poses, figures.divides_of(store))
    return {
        "nodes": int((poses.ids > 0).sum()),
        "landmarks": int((poses.ids < 0).sum()),
        "constraints": audit.counts_of(constraints),
        "components": [
            {"first": first, "last": last, "nodes": count} for first, last, count in parts
        ],
        "variance_factors": factors,
        "overconfidence": residual,
        "overconfident": [
            kind
            for kind, r in residual.items()
            if audit.is_overconfident(r, factors.get(kind, 1.0))
        ],
        "uncertainty": audit.uncertainty_of(poses),
        "worst": [_shown(m.constraint, m) for m in accepted[:worst]],
        "corrections": [
            {**_shown(m.constraint, m), "start_metres": metres, "start_degrees": degrees}
            for m, metres, degrees in corrections[:worst]
        ],
        "rejected": [_shown(c, m) for c, m in rejected[:rejected_shown]],
        "rejected_reasons": dict(Counter(c.verdicts[-1].why for c, _ in rejected).most_common()),
        "certainty": (solved or {}).get("certainty", ""),
        "problems": figures.contradictions_of(solved or {}),
    }


def _shown(constraint: Judged, residual: Any) -> dict[str, Any]:
    row: dict[str, Any] = {
        "kind": str(constraint.kind),
        "from": constraint.from_id,
        "to": constraint.to_id,
        "reason": reason_of(constraint),
    }
    if residual is not None:
        row |= {"metres": residual.metres, "degrees": residual.degrees, "sigmas": residual.sigmas}
    return row


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [f"nodes       {facts['nodes']}"]
    if facts["landmarks"]:
        lines.append(f"landmarks   {facts['landmarks']}")
    lines += _component_lines(facts["components"])
    if facts["certainty"]:
        lines.append(f"certainty   {facts['certainty']}")
    if facts["uncertainty"]:
        lines.append(_uncertainty_line(facts))
    if "between" in facts:
        lines.append(_between_line(facts["between"]))
    lines += [f"problem     {line}" for line in facts["problems"]]
    return [*lines, "", *_kind_lines(facts), *_worst_lines(facts), *_rejected_lines(facts)]


def _uncertainty_line(facts: dict[str, Any]) -> str:
    spread, counts = facts["uncertainty"], facts["constraints"]
    tied = any(row["accepted"] for kind, row in counts.items() if kind in OF_ONE_NODE)
    frame = "the map" if tied else "the first node"
    return (
        f"uncertainty median {spread['median_metres']:.3g} m, {spread['median_degrees']:.2g} deg; "
        f"largest {spread['largest_metres']:.3g} m (node {spread['largest_at']}), "
        f"{spread['largest_degrees']:.2g} deg, relative to {frame}"
    )


def _kind_lines(facts: dict[str, Any]) -> list[str]:
    """A line each kind of constraint, and a warning for each that claims too much."""
    titles = ("tried", "accepted", "rejected", "variance", "residual")
    lines = [f"{'constraints':<14}" + "".join(f"{title:>10}" for title in titles)]
    for kind, row in facts["constraints"].items():
        counts = "".join(f"{row[title]:>10}" for title in titles[:3])
        factor, residual = facts["variance_factors"].get(kind), facts["overconfidence"].get(kind)
        shown = "" if factor is None else f"{factor:.2g}"
        lines.append(
            f"{kind:<14}{counts}{shown:>10}" + ("" if residual is None else f"{residual:>10.2f}")
        )
    lines += [
        "variance factor of the stated covariances, as what contradicts them in this map says",
        "normalised residual (1 = consistent with the stated covariance) of accepted constraints, "
        "times its variance factor",
    ]
    return lines + [
        f"warning: {kind} constraints were stated over-confident: variance factor "
        f"{facts['variance_factors'].get(kind, 1.0):.2g}, normalised residual "
        f"{facts['overconfidence'][kind]:.2f}"
        for kind in facts["overconfident"]
    ]


def _worst_lines(facts: dict[str, Any]) -> list[str]:
    """Accepted constraints with the largest residuals, and what closures moved."""
    lines = []
    if facts["worst"]:
        lines += ["", "accepted constraints with the largest residuals"]
        lines += [_row(row, "reject") for row in facts["worst"]]
    if facts["corrections"]:
        lines += ["", "closures that moved most (miss before -> after)"]
        lines += [
            f"  {_name(row)}  {row['start_metres']:.2f} m, {row['start_degrees']:.1f} deg -> "
            f"{row['metres']:.3f} m, {row['degrees']:.2f} deg"
            for row in facts["corrections"]
        ]
    return lines


def _rejected_lines(facts: dict[str, Any]) -> list[str]:
    if not facts["rejected"]:
        return []
    total = sum(facts["rejected_reasons"].values())
    counts = [f"  {n:>6} x {reason}" for reason, n in facts["rejected_reasons"].items()][:12]
    return [
        "",
        f"rejected constraints ({len(facts['rejected'])} of {total} shown)",
        *counts,
        *(_row(row, "accept") for row in facts["rejected"]),
    ]


def _between_line(row: dict[str, Any]) -> str:
    place = " ".join(f"{value:+.3f}" for value in row["xyz"])
    sigmas = " ".join(f"{value:.3g}" for value in row["sigmas_xyz"])
    return (
        f"{row['from']} -> {row['to']}".ljust(12)
        + f"{place} m, turned {_turn(row['roll_pitch_yaw'])}; one sigma "
        f"{sigmas} m, {row['sigma_degrees']:.2g} deg"
    )


def _turn(roll_pitch_yaw: Sequence[float]) -> str:
    """With its sign: to the left is positive."""
    roll, pitch, yaw = roll_pitch_yaw
    if max(abs(roll), abs(pitch)) < _LEVEL:
        return f"{yaw:+.2f} deg"
    return f"{roll:+.2f} {pitch:+.2f} {yaw:+.2f} deg (roll, pitch, yaw)"


def _component_lines(parts: list[dict[str, int]]) -> list[str]:
    if len(parts) <= 1:
        return ["connected   all nodes"]
    lines = [f"connected   NO: {len(parts)} components"]
    return lines + [
        f"            nodes {p['first']} to {p['last']} ({p['nodes']} nodes)" for p in parts[:10]
    ]


def _name(row: dict[str, Any]) -> str:
    return name_of_ends(row["kind"], row["from"], row["to"])


def _row(row: dict[str, Any], action: str) -> str:
    fit = ""
    if "metres" in row:
        fit = f"{row['metres']:.3f} m, {row['degrees']:.2f} deg, {row['sigmas']:.1f} sigma"
    line = f"  {_name(row)}  {fit}  {row['reason']}".rstrip()
    if row["kind"] == ConstraintKind.NEIGHBOUR or row["kind"] in OF_ONE_NODE:
        return line
    paste = f'from = {row["from"]}\nto = {row["to"]}\nkind = "{row["kind"]}"\nreason = ""'
    return "\n".join([line, f"[[{action}]]", *paste.splitlines()])
