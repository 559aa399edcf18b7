"""Maps read and scored side by side, for `mapmyworld compare`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cli.report import read_timing
from cli.standard_streams import in_columns
from formats.database import open_store
from formats.report.map_pictures import MapPanel, write_compare_picture
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.evaluation import TrajectoryScore, ate, relations_score
from mapmyworld.evaluation.sharpness import grid_sharpness
from mapmyworld.exporting import trajectory_of
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.map_figures import tracked_path
from mapmyworld.mapping.occupancy import build_grid
from mapmyworld.stages.draw_maps import scans_at
from mapmyworld.stages.kept import has_scans
from mapmyworld.types import MapStore, OccupancyGrid, Trajectory
from mapmyworld.types.maps import Relations

# Figure -> heading and format of its column, in the order of printing.
COLUMNS: dict[str, tuple[str, str]] = {
    "frames": ("frames", "d"),
    "length_m": ("length m", ".1f"),
    "ate_m": ("ATE m", ".4f"),
    "relations": ("relations", "d"),
    "relations_m": ("relations m", ".4f"),
    "relations_std_m": ("+- m", ".4f"),
    "relations_deg": ("relations deg", ".3f"),
    "apart_m": ("from first m", ".4f"),
    "entropy_bits": ("entropy bit", ".3f"),
    "wall_thickness_m": ("walls m", ".4f"),
    "free_m2": ("free m2", ".1f"),
    "cpu_s": ("CPU s", ".1f"),
    "wall_s": ("wall s", ".1f"),
    "peak_memory_mb": ("peak MB", ".0f"),
}
_CAPTIONS = (
    ("ate_m", "relations_m", "relations_deg"),
    ("entropy_bits", "wall_thickness_m", "cpu_s", "peak_memory_mb"),
)
"""What stands in the lines above a picture, behind the map's name."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One of the maps."""

    name: str
    trajectory: Trajectory
    grid: OccupancyGrid | None
    summary: dict[str, Any] = field(default_factory=dict)


def read_candidate(path: Path) -> Candidate:
    """A finished map from its file; and what its stages took, where a file beside it says so."""
    cost: dict[str, Any] = {}
    if timing := read_timing(path):
        cost = {key: sum(stage[key] for stage in timing["stages"]) for key in ("cpu_s", "wall_s")}
        cost["peak_memory_mb"] = max(stage["peak_memory_mb"] for stage in timing["stages"])
    with open_store(path, read_only=True) as store:
        return Candidate(path.stem, trajectory_of(store), store.grid(), cost)


def without_closures(store: MapStore, config: Config) -> Candidate:
    """What the neighbour constraints alone make of a map's scans: tracking, and nothing else."""
    frames = store.tracked_frames()
    poses = tracked_path(store.nodes(), frames)
    scans = scans_at(store, np.arange(len(poses)), poses)
    grid = build_grid(scans, config, poses[:, :2, 3]) if has_scans(store) else None
    return Candidate("neighbour", Trajectory(frames.stamps_ns, poses), grid)


def figures_of(
    candidate: Candidate,
    first: Candidate,
    reference: Trajectory | None,
    relations: Relations | None,
) -> dict[str, Any]:
    """Every figure that can be had of a map."""
    positions = candidate.trajectory.poses[:, :3, 3]
    figures: dict[str, Any] = {
        "name": candidate.name,
        "frames": len(positions),
        "length_m": float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
    }
    if reference is not None:
        figures["ate_m"] = ate(candidate.trajectory, reference).rmse
    if relations is not None:
        figures |= _related(candidate.trajectory, relations)
    if (laid := _laid_upon(first, candidate)) is not None:
        figures["apart_m"] = laid.rmse
    if candidate.grid is not None:
        grid = candidate.grid
        figures |= asdict(grid_sharpness(grid))
        figures |= {"free_m2": grid.area_m2(0), "occupied_m2": grid.area_m2(100)}
    wanted = ("cpu_s", "wall_s", "peak_memory_mb")
    figures |= {key: candidate.summary[key] for key in wanted if key in candidate.summary}
    return {key: value for key, value in figures.items() if value is not None}


def _laid_upon(first: Candidate, candidate: Candidate) -> TrajectoryScore | None:
    """A map's path against the first one's; None for that one, or without a common moment."""
    if candidate is first:
        return None
    try:
        return ate(candidate.trajectory, first.trajectory)
    except MapError:
        return None


def _related(trajectory: Trajectory, relations: Relations) -> dict[str, Any]:
    """Errors against the known relations of the map's time; nothing where none is."""
    try:
        score = relations_score(trajectory, relations)
    except MapError:
        return {}
    return {
        "relations": score.count,
        "relations_m": score.translation.mean,
        "relations_std_m": score.translation.std,
        "relations_deg": score.rotation_deg.mean,
    }


def table_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The figures as a table: a map a line, a figure a column."""
    keys = [key for key in COLUMNS if any(key in row for row in rows)]
    heads = ["map", *(COLUMNS[key][0] for key in keys)]
    cells = [
        [row["name"], *(f"{row[k]:{COLUMNS[k][1]}}" if k in row else "-" for k in keys)]
        for row in rows
    ]
    return in_columns([heads, *cells])


def draw_maps(path: Path, candidates: Sequence[Candidate], rows: Sequence[dict[str, Any]]) -> None:
    """All maps that have a grid, laid upon the first, in one picture.

    Raises `MapError` where none has one.
    """
    panels = []
    for candidate, row in zip(candidates, rows, strict=True):
        if candidate.grid is None:
            continue
        laid = _laid_upon(candidates[0], candidate)
        first_from_map = (
            np.zeros(3) if laid is None else matrix_to_planar(laid.reference_from_estimate)
        )
        driven = candidate.trajectory.poses[:, :2, 3]
        panels.append(MapPanel(candidate.grid, first_from_map, driven, _captions(row)))
    if not panels:
        raise MapError("none of these maps has a grid to draw: build them from a log with scans")
    write_compare_picture(path, panels)


def _captions(row: dict[str, Any]) -> tuple[str, ...]:
    accuracy, rest = (
        [f"{COLUMNS[key][0]} {row[key]:{COLUMNS[key][1]}}" for key in keys if key in row]
        for keys in _CAPTIONS
    )
    return tuple(", ".join(part) for part in ([row["name"], *accuracy], rest) if part)
