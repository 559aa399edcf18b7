"""What the HTML report shows of a map."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import mapmyworld
from cli.figure_names import problems_of
from cli.report_evidence import fetch_evidence
from cli.report_summary import headline, products, verdict
from formats.report.contents import ReportContents, ShownConstraint, ShownNodes
from formats.report.report_page import ellipses_of, report_html
from formats.whole_files import write_whole
from mapmyworld.config import Config
from mapmyworld.errors import MapError, MapMyWorldError
from mapmyworld.exporting import frame_poses, grid_at, is_planar
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import invert
from mapmyworld.graph import audit
from mapmyworld.graph.variance import normalised_residuals
from mapmyworld.map_figures import calibrated_constraints, map_figures, tracked_poses
from mapmyworld.stages.kept import has_scans
from mapmyworld.types import ConstraintKind, Judged, MapStore, Node, OccupancyGrid, Poses
from mapmyworld.types.wording import reason_of

if TYPE_CHECKING:
    from cli.progress import StageCost

_TIMING = ".timing.json"  # where `build` notes what its stages took
_SHOWN = ("name", "wall_s", "cpu_s", "peak_memory_mb", "rounds")  # of a stage


def write_report(store: MapStore, path: Path) -> None:
    """The page as a file."""
    write_whole(path, report_html(report_contents(store, path.parent)))


def note_timing(
    map_path: Path, cost: Mapping[str, Any], stages: Sequence[StageCost], *, continued: bool
) -> None:
    """Keeps what a build took beside its map; stages that were reused keep their old figures."""
    fresh = {stage.name: {name: getattr(stage, name) for name in _SHOWN} for stage in stages}
    old = (read_timing(map_path) if continued else None) or {"stages": []}
    kept = [stage for stage in old["stages"] if stage["name"] not in fresh]
    built = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    timing = {"built": built, **cost, "stages": [*kept, *fresh.values()]}
    write_whole(map_path.with_suffix(_TIMING), json.dumps(timing, indent=1) + "\n")


def read_timing(map_path: Path) -> dict[str, Any] | None:
    """What `build` left beside the map; None where nothing, or nothing that can be read."""
    try:
        found = json.loads(map_path.with_suffix(_TIMING).read_text("utf-8"))
        stages = {(s["name"], sum(s[name] for name in _SHOWN[1:4])) for s in found["stages"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if stages else None


def report_contents(store: MapStore, folder: Path | None = None) -> ReportContents:
    """Everything that the page shows; raises `MapError` where the map holds no nodes.

    `folder`: where the page will be, so that its links lead to the map's products.
    """
    nodes, constraints = store.nodes(), store.constraints()
    if not nodes:
        raise MapError(f"{_name(store)}: holds no nodes to report on")
    solved = store.poses() or tracked_poses(nodes)
    path, fetched = _path(store, nodes), fetch_evidence(store, constraints)
    problems, grid = problems_of(store), _grid(store)
    decisions = (store.get("plan") or {}).get("decisions", ())
    return ReportContents(
        name=Path(_name(store)).name,
        version=mapmyworld.__version__,
        headline=headline(map_figures(store), grid),
        products=products(Path(_name(store)), folder),
        verdict=verdict(map_figures(store), problems),
        proof=str((store.get("solve") or {}).get("certainty", "")),
        problems=problems,
        grid=grid,
        path=path,
        odometry=_odometry(nodes, solved),
        nodes=_shown_nodes(nodes, solved),
        constraints=_shown_constraints(constraints, solved, nodes),
        evidence=fetched.evidence,
        evidence_left_out=fetched.left_out,
        pictures=fetched.pictures,
        scans=fetched.scans,
        cloud=cloud_beside(store),
        decisions=[(d["role"], d["choice"] or "none", d["reason"]) for d in decisions],
        notes=_notes(store, problems),
        diagnosis=_diagnosis(store),
        settings=[tuple(row) for row in store.get("settings") or ()],
        reproduce=_reproduce(store),
        overconfidence=normalised_residuals(
            calibrated_constraints(store), solved, is_planar(solved.map_from_node)
        ),
        timing=read_timing(Path(_name(store))),
    )


def _name(store: MapStore) -> str:
    return str(getattr(store, "path", "map"))


def _grid(store: MapStore) -> OccupancyGrid | None:
    """The stored grid; drawn from the scans where there is none, as in RTAB-Map's files."""
    grid = store.grid()
    if grid is None and has_scans(store):
        try:
            grid = grid_at(store, Config(), None)
        except MapMyWorldError:
            return None
    return grid


def _path(store: MapStore, nodes: Sequence[Node]) -> Array:
    """Time since the first node, x and y (F, 3) of every tracked frame."""
    frames, poses = frame_poses(store)
    stamps = store.tracked_frames().stamps_ns[frames]
    return np.column_stack([(stamps - nodes[0].stamp_ns) * 1e-9, poses[:, :2, 3]])


def _odometry(nodes: Sequence[Node], solved: Poses) -> Array:
    """Recorded odometry (N, 2) of the first session's nodes, moved onto the first pose."""
    first = [node for node in nodes if node.session == nodes[0].session]
    start = solved.map_from_node[0] @ invert(first[0].odom_from_base)
    return np.asarray((start @ np.stack([n.odom_from_base for n in first]))[:, :2, 3])


def _shown_nodes(nodes: Sequence[Node], solved: Poses) -> ShownNodes:
    known = {int(i): k for k, i in enumerate(solved.ids)}
    kept = [node for node in nodes if node.id in known]
    rows = np.array([known[node.id] for node in kept], np.int64)
    places = matrix_to_planar(solved.map_from_node[rows])
    sigmas = ellipses = None
    if solved.covariances is not None and len(solved.covariances) >= len(rows):
        covariances = solved.covariances[rows]
        sigmas = audit.sigmas_of(covariances)[0]
        ellipses = ellipses_of(covariances[:, 3:5, 3:5], places[:, 2])
    return ShownNodes(
        np.array([node.id for node in kept], np.int64),
        np.array([node.session for node in kept], np.int64),
        np.array([(node.stamp_ns - nodes[0].stamp_ns) * 1e-9 for node in kept]),
        places,
        sigmas,
        ellipses,
    )


def _shown_constraints(
    constraints: Sequence[Judged], solved: Poses, nodes: Sequence[Node]
) -> list[ShownConstraint]:
    """Against the solution, and against the path before any closure."""
    planar = is_planar(solved.map_from_node)
    residuals = audit.residuals_against(constraints, solved, planar)
    tracked = audit.residuals_against(constraints, tracked_poses(nodes), planar)
    return [
        ShownConstraint(
            c.from_id,
            c.to_id,
            c.kind,
            c.accepted,
            reason_of(c),
            None if m is None else (m.metres, m.degrees, m.sigmas),
            None if s is None or c.kind == ConstraintKind.NEIGHBOUR else (s.metres, s.degrees),
        )
        for c, m, s in zip(constraints, residuals, tracked, strict=True)
    ]


def _notes(store: MapStore, problems: Sequence[str]) -> list[str]:
    reported = list((store.get("plan") or {}).get("warnings", ()))
    for key in ("track", "wheels", "solve"):
        reported += (store.get(key) or {}).get("notes", ())
    return [line for line in dict.fromkeys(reported) if line not in problems]


def _diagnosis(store: MapStore) -> list[tuple[bool, str, str]]:
    """What tracking the log said of its sensors; what is not as it should be stands first."""
    found = [(f["good"], f["text"], f["suggestion"]) for f in store.get("diagnosis") or ()]
    return sorted(found, key=lambda row: row[0])


def _reproduce(store: MapStore) -> str:
    """The command that makes these bytes again."""
    log = store.get("log")
    if log is None:
        return ""
    changed = " ".join(f"--set {name}={value}" for name, value, _ in store.get("settings") or ())
    words = ["mapmyworld build", " ".join(log["paths"]), "-o", Path(_name(store)).name, changed]
    return (
        f"pip install mapmyworld=={mapmyworld.__version__}\n{' '.join(w for w in words if w)}\n"
        f"# the log's content hash: {log['hash']}"
    )


def cloud_beside(store: MapStore) -> Any:
    """The cloud that was written beside the map, if it is there."""
    from formats.cloud_files import read_cloud

    path = Path(_name(store)).with_suffix(".ply")
    try:
        return read_cloud(path) if path.is_file() else None
    except MapMyWorldError:
        return None
