"""`mapmyworld evaluate`: scores against the truth."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import Any

import click

from cli.arguments import PATH, FiniteRange, format_option
from cli.standard_streams import end_partial, show_result
from mapmyworld.errors import MapError


@click.group()
def evaluate() -> None:
    """Score a trajectory, a grid, a cloud or loop closures against the truth.

    \b
    mapmyworld evaluate trajectory map.db log.mcap.truth/trajectory.tum
    mapmyworld evaluate relations map.db intel.relations
    mapmyworld evaluate grid map.yaml log.mcap.truth/grid.yaml
    """


@evaluate.command()
@click.argument("estimate", type=PATH)
@click.argument("reference", type=PATH)
@click.option("--align/--no-align", default=True, help="Best rigid alignment first (ATE).")
@click.option(
    "--delta",
    type=FiniteRange(0),
    default=1.0,
    metavar="M",
    help="Path between the two poses of the RPE [m].",
)
@click.option(
    "--max-difference", type=FiniteRange(0), default=0.01, metavar="S",
    help="Largest time between poses that are matched [s].",
)  # fmt: skip
@format_option
def trajectory(
    estimate: Path, reference: Path, align: bool, delta: float, max_difference: float
) -> None:
    """ATE and RPE of ESTIMATE against REFERENCE. By evo's definitions.

    Either is a TUM file or a MAP. Of a MAP, NEES per unknown shows whether its covariances are
    consistent with its errors: 1 is, more is over-confident. RPE is left out, and the exit code is
    3, where no two poses are --delta apart.

    \b
    mapmyworld evaluate trajectory map.db log.mcap.truth/trajectory.tum
    """
    from cli.scoring import coverage, nees_of_map, read_any_trajectory
    from mapmyworld.evaluation import ate, rpe

    poses, truth = read_any_trajectory(estimate), read_any_trajectory(reference)
    absolute = ate(poses, truth, align=align, max_difference_s=max_difference)
    parts = {"ate": absolute.translation, "ate_rotation_deg": absolute.rotation_deg}
    left_out = []
    try:
        relative = rpe(poses, truth, distance=delta, max_difference_s=max_difference)
        parts |= {"rpe": relative.translation, "rpe_rotation_deg": relative.rotation_deg}
    except MapError as error:
        left_out = [f"RPE is left out: {error}: give a smaller --delta"]
    nees = nees_of_map(estimate, truth, max_difference)
    covered, nothing = coverage(poses, truth), dict.fromkeys(("rpe", "rpe_rotation_deg"))
    errors = nothing | {n: asdict(s) for n, s in parts.items()}
    lines = [
        f"{parts['ate'].count} poses matched, {100 * covered:.0f}% of the time",
        f"{'':18}{'rmse':>9}{'mean':>9}{'median':>9}{'max':>9}",
    ]
    names = ["ATE [m]", "ATE [deg]", f"RPE [m] / {delta:g} m", f"RPE [deg] / {delta:g} m"]
    for name, s in zip(names, parts.values(), strict=False):
        lines.append(f"{name:18}{s.rmse:9.4f}{s.mean:9.4f}{s.median:9.4f}{s.maximum:9.4f}")
    if nees is not None:
        lines.append(
            f"{'NEES per unknown':18}{nees:9.2f}  (1 = consistent with the map's covariances)"
        )
    show_result(errors | {"covered": covered, "nees": nees}, lines)
    end_partial(left_out)


@evaluate.command()
@click.argument("estimate", type=PATH)
@click.argument("relations", type=PATH)
@format_option
def relations(estimate: Path, relations: Path) -> None:
    """Kuemmerle's metric of ESTIMATE against known RELATIONS. ESTIMATE is a MAP or a TUM file.

    Relations outside ESTIMATE's time are not scored; the exit code is 3 where they are most.

    \b
    mapmyworld evaluate relations map.db intel.relations
    """
    from cli.scoring import few_relations, read_any_trajectory
    from formats.relation_files import read_relations
    from mapmyworld.evaluation import relations_score

    score = relations_score(read_any_trajectory(estimate), read_relations(relations))
    figures = {
        "translation_m": score.translation,
        "rotation_deg": score.rotation_deg,
        "squared_translation_m2": score.squared_translation,
        "squared_rotation_deg2": score.squared_rotation_deg,
        "cartographer_translation_m": score.cartographer_translation,
    }
    shown: dict[str, Any] = {name: asdict(value) for name, value in figures.items()}
    left_out = f", {score.outside} more lie outside its time" if score.outside else ""
    lines = [f"{score.count} relations in the trajectory's time{left_out}"]
    lines += [f"{n:28}{value.mean:9.4f} +- {value.std:.4f}" for n, value in figures.items()]
    show_result({"count": score.count, "outside": score.outside} | shown, lines)
    end_partial(few_relations(score))


@evaluate.command()
@click.argument("grid", type=PATH)
@click.argument("reference", type=PATH)
@format_option
def grid(grid: Path, reference: Path) -> None:
    """How well two grids agree, as they lie and best aligned. Named by their YAML files.

    \b
    mapmyworld evaluate grid map.yaml log.mcap.truth/grid.yaml
    """
    from formats.grid_files import read_grid
    from mapmyworld.evaluation import grid_score

    score = grid_score(read_grid(grid), read_grid(reference))
    facts = {
        "unaligned": asdict(score.unaligned),
        "aligned": asdict(score.aligned),
        "reference_from_grid": score.reference_from_grid.tolist(),
        "unknown": score.unknown,
    }
    lines = [
        f"{'':12}{'precision':>11}{'recall':>9}{'precision':>11}{'recall':>9}{'free':>9}",
        f"{'':12}{'1 cell':>11}{'1 cell':>9}{'2 cells':>11}{'2 cells':>9}{'right':>9}",
    ]
    for name, a in [("unaligned", score.unaligned), ("aligned", score.aligned)]:
        shares = [a.precision_1, a.recall_1, a.precision_2, a.recall_2, a.free]
        row = "".join(f"{v:>{w}.3f}" for v, w in zip(shares, (11, 9, 11, 9, 9), strict=True))
        lines.append(f"{name:12}{row}")
    x, y, yaw = score.reference_from_grid
    lines.append(f"aligned by {x:.3f} m, {y:.3f} m, {yaw:.4f} rad; unknown {score.unknown:.3f}")
    show_result(facts, lines)


@evaluate.command()
@click.argument("map_path", metavar="MAP", type=PATH)
@click.argument("reference", type=PATH)
@format_option
def loops(map_path: Path, reference: Path) -> None:
    """Precision and recall of MAP's loop closures. REFERENCE is the true trajectory.

    Right is within 0.20 m and 1 degree. Recall needs loop_pairs.csv beside REFERENCE.

    \b
    mapmyworld evaluate loops map.db log.mcap.truth/trajectory.tum
    """
    from cli.scoring import read_any_trajectory, score_loops, truth_beside
    from formats.database import open_store

    pairs = truth_beside(reference)
    with open_store(map_path, read_only=True) as store:
        score = score_loops(store, read_any_trajectory(reference), pairs)
    recall = None if isnan(score.recall) else score.recall
    lines = [
        f"closures:  {len(score.right)}, {int(score.right.sum())} of them right",
        f"precision: {score.precision:.3f}",
    ]
    if recall is not None:
        lines.append(f"recall:    {recall:.3f}")
    elif pairs is not None:
        lines.append("recall:    there is no true loop to find")
    show_result({"count": len(score.right), "precision": score.precision, "recall": recall}, lines)


@evaluate.command()
@click.argument("cloud", type=PATH)
@click.argument("mesh", type=PATH)
@click.option(
    "--trajectory",
    "est",
    type=PATH,
    help="The map's trajectory: with --reference, aligns the cloud first.",
)
@click.option("--reference", type=PATH, help="True trajectory, a TUM file or a MAP.")
@format_option
def cloud(cloud: Path, mesh: Path, est: Path | None, reference: Path | None) -> None:
    """Metres of CLOUD's points from the surfaces of MESH. CLOUD is .ply or .pcd, MESH .ply or .glb.

    \b
    mapmyworld evaluate cloud map.ply log.mcap.truth/mesh.ply
    """
    from cli.scoring import read_any_trajectory
    from formats.cloud_files import read_cloud
    from formats.scene_mesh import read_scene_mesh
    from mapmyworld.evaluation import ate, cloud_score
    from mapmyworld.geometry.rigid import transform_points
    from mapmyworld.types import PointCloud

    if (est is None) != (reference is None):
        raise click.UsageError("--trajectory and --reference go together")
    points = read_cloud(cloud)
    if est is not None and reference is not None:
        found = ate(read_any_trajectory(est), read_any_trajectory(reference))
        moved = transform_points(found.reference_from_estimate, points.points)
        points = PointCloud(moved.astype("float32"))
    score = cloud_score(points, read_scene_mesh(mesh))
    facts = asdict(score)
    show_result(facts, [f"{name:10}{value:10.4f}" for name, value in facts.items()])
