"""What `check` can require of a map, and how each figure is found."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from cli.figure_names import figures_of
from cli.scoring import coverage, read_any_trajectory, score_loops, truth_beside
from formats.grid_files import read_grid
from formats.relation_files import read_relations
from mapmyworld.errors import ConfigError
from mapmyworld.evaluation import (
    GridScore,
    LoopScore,
    RelationsScore,
    TrajectoryScore,
    ate,
    grid_score,
    relations_score,
    rpe,
)
from mapmyworld.exporting import trajectory_of
from mapmyworld.graph.audit import sigmas_of
from mapmyworld.types import ConstraintKind, MapStore, OccupancyGrid, Trajectory


@dataclass(frozen=True)
class Facts:
    """Figures of one map, each worked out when first asked for."""

    store: MapStore
    map_path: Path
    files: Mapping[str, Path]
    """By the options that give them: reference, relations, grid."""

    @cached_property
    def figures(self) -> dict[str, float]:
        """Every figure by its dotted name."""
        return figures_of(self.store)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Where the robot was, by the map."""
        return trajectory_of(self.store)

    @cached_property
    def reference(self) -> Trajectory:
        """Where it was in truth."""
        return read_any_trajectory(self.files["reference"])

    @cached_property
    def absolute(self) -> TrajectoryScore:
        """ATE against the reference."""
        return ate(self.trajectory, self.reference)

    @cached_property
    def relative(self) -> TrajectoryScore:
        """RPE over each metre of the reference."""
        return rpe(self.trajectory, self.reference, distance=1.0)

    @cached_property
    def related(self) -> RelationsScore:
        """Errors of the map's relations."""
        return relations_score(self.trajectory, read_relations(self.files["relations"]))

    @cached_property
    def loops(self) -> LoopScore:
        """How many closures are right."""
        pairs = truth_beside(self.files["reference"])
        return score_loops(self.store, self.reference, pairs)

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map's grid; `ConfigError` where it has none."""
        grid = self.store.grid()
        if grid is None:
            raise ConfigError(f"{self.map_path} has no grid to check: build it with scans")
        return grid

    @cached_property
    def agreement(self) -> GridScore:
        """How the grid agrees with the reference's."""
        return grid_score(self.grid, read_grid(self.files["grid"]))

    def largest_sigma(self) -> float:
        """Metres of the least certain node; `ConfigError` where there are no covariances."""
        poses = self.store.poses()
        if poses is None or poses.covariances is None or len(poses.covariances) == 0:
            raise ConfigError(f"{self.map_path} has no covariances to check")
        return float(sigmas_of(poses.covariances)[0].max())


@dataclass(frozen=True, slots=True)
class Key:
    """A figure that a requirement can name."""

    about: str
    find: Callable[[Facts], float]
    needs: str = ""
    """The option without which it cannot be found."""
    better: int = 0
    """1 where more is better than less, -1 where less is; 0 where neither."""


def _accepted(kind: ConstraintKind) -> Callable[[Facts], float]:
    return lambda facts: float(
        sum(c.kind == kind and c.accepted for c in facts.store.constraints())
    )


KEYS: dict[str, Key] = {
    "nodes": Key("nodes of the graph", lambda f: float(len(f.store.nodes()))),
    "sessions": Key("sessions", lambda f: float(len({n.session for n in f.store.nodes()}))),
    "frames": Key("tracked moments", lambda f: float(len(f.store.tracked_frames().stamps_ns))),
    "neighbour": Key("neighbour constraints", _accepted(ConstraintKind.NEIGHBOUR)),
    "loop_closures": Key(
        "accepted loop closures", _accepted(ConstraintKind.LOOP_CLOSURE), better=1
    ),
    "proximity": Key("accepted proximity constraints", _accepted(ConstraintKind.PROXIMITY)),
    "landmarks": Key("accepted landmark constraints", _accepted(ConstraintKind.LANDMARK)),
    "rejected": Key(
        "rejected constraints of any kind",
        lambda f: float(sum(not c.accepted for c in f.store.constraints())),
    ),
    "unknown_share": Key(
        "share of the grid's cells never seen",
        lambda f: float((f.grid.trinary() < 0).mean()),
        better=-1,
    ),
    "free_area": Key("m2 of free floor", lambda f: f.grid.area_m2(0), better=1),
    "largest_sigma": Key("m, of the least certain node", lambda f: f.largest_sigma(), better=-1),
    "covered": Key(
        "share of the reference's time mapped",
        lambda f: coverage(f.trajectory, f.reference),
        "reference",
        better=1,
    ),
    "ate_rmse": Key("m, after alignment", lambda f: f.absolute.rmse, "reference", -1),
    "ate_max": Key("m, after alignment", lambda f: f.absolute.translation.maximum, "reference", -1),
    "ate_rotation": Key("deg, rmse", lambda f: f.absolute.rotation_deg.rmse, "reference", -1),
    "rpe_rmse": Key("m a metre", lambda f: f.relative.rmse, "reference", -1),
    "rpe_rotation": Key(
        "deg a metre, rmse", lambda f: f.relative.rotation_deg.rmse, "reference", -1
    ),
    "loop_precision": Key("share of right closures", lambda f: f.loops.precision, "reference", 1),
    "loop_recall": Key("share of true loops found", lambda f: f.loops.recall, "reference", 1),
    "relations_translation": Key(
        "m, mean error", lambda f: f.related.translation.mean, "relations", -1
    ),
    "relations_covered": Key(
        "share of the relations in the map's time, which are scored",
        lambda f: f.related.share,
        "relations",
    ),
    "relations_rotation": Key(
        "deg, mean error", lambda f: f.related.rotation_deg.mean, "relations", -1
    ),
    "grid_precision": Key(
        "within one cell, aligned", lambda f: f.agreement.aligned.precision_1, "grid", 1
    ),
    "grid_recall": Key(
        "within one cell, aligned", lambda f: f.agreement.aligned.recall_1, "grid", 1
    ),
    "grid_free": Key("share of free cells right", lambda f: f.agreement.aligned.free, "grid", 1),
}
BETTER = {name: key.better for name, key in KEYS.items() if key.better}
"""The keys that can be compared with an older map's."""


def measure(wanted: set[str], facts: Facts) -> dict[str, float]:
    """The figures asked for, by key or dotted name.

    Raises `ConfigError` where an option that they need was not given, or the map has none of these.
    """
    needed = sorted({KEYS[key].needs for key in wanted & KEYS.keys()} - {""})
    if absent := [f"--{option} FILE" for option in needed if option not in facts.files]:
        raise ConfigError(f"these requirements need {', '.join(absent)}")
    problems = []
    for name in sorted(wanted - KEYS.keys()):
        if name not in facts.figures:
            near = difflib.get_close_matches(name, facts.figures, 1)
            hint = f"did you mean {near[0]}?" if near else "`--keys` lists them"
            problems.append(f"this map has no figure {name}: {hint}")
    if problems:
        raise ConfigError("the check cannot be made:", problems=problems)
    return {key: KEYS[key].find(facts) if key in KEYS else facts.figures[key] for key in wanted}
