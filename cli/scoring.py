"""What `evaluate`, `check` and `compare` share: trajectories, loops and clouds from any file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.database import open_store
from formats.database.connection import is_sqlite
from formats.trajectory_files import read_trajectory
from formats.truth_files import read_loop_pairs
from mapmyworld.evaluation import FEW, LoopScore, RelationsScore, loop_closure_score
from mapmyworld.evaluation.nees import map_nees
from mapmyworld.exporting import trajectory_of
from mapmyworld.types import CLOSURES, MapStore, Trajectory


def read_any_trajectory(path: Path) -> Trajectory:
    """The trajectory of a map (every tracked frame where kept) or of a TUM file."""
    if is_sqlite(path):
        with open_store(path, read_only=True) as store:
            return trajectory_of(store)
    return read_trajectory(path)


def nees_of_map(path: Path, truth: Trajectory, max_difference_s: float) -> float | None:
    """A map's errors against its own covariances; None for a file without any."""
    if not is_sqlite(path):
        return None
    with open_store(path, read_only=True) as store:
        nodes, poses = store.nodes(), store.poses()
    return None if poses is None else map_nees(nodes, poses, truth, max_difference_s)


def truth_beside(reference: Path) -> NDArray[np.int64] | None:
    """The true loops (P, 2) of `loop_pairs.csv` beside a true trajectory, where it is."""
    path = reference.with_name("loop_pairs.csv")
    return read_loop_pairs(path) if path.is_file() else None


def score_loops(store: MapStore, truth: Trajectory, pairs: NDArray[np.int64] | None) -> LoopScore:
    """Accepted loop closures and proximity constraints, by the truth and true `pairs` (P, 2)."""
    stamps = {node.id: node.stamp_ns for node in store.nodes()}
    kept = [
        c
        for c in store.constraints()
        if c.accepted and c.kind in CLOSURES and c.from_id in stamps and c.to_id in stamps
    ]
    moments = np.array([[stamps[c.from_id], stamps[c.to_id]] for c in kept], np.int64)
    measured = np.array([c.i_from_j for c in kept], np.float64)
    true_pairs = np.zeros((0, 2), np.int64) if pairs is None else pairs
    return loop_closure_score(moments.reshape(-1, 2), measured.reshape(-1, 4, 4), truth, true_pairs)


def few_relations(score: RelationsScore) -> list[str]:
    """That a score is of few of the relations, and what to do; nothing where it is of most."""
    if score.share >= FEW:
        return []
    return [
        f"only {score.count} of {len(score.covered)} relations lie in the trajectory's time: the "
        "score is of these alone; give the map of the whole log"
    ]


def coverage(estimate: Trajectory, reference: Trajectory) -> float:
    """Share of the reference's time that the estimate spans, 0 to 1."""
    whole = int(reference.stamps_ns.max() - reference.stamps_ns.min())
    first = max(estimate.stamps_ns.min(), reference.stamps_ns.min())
    last = min(estimate.stamps_ns.max(), reference.stamps_ns.max())
    return float(max(0, int(last - first)) / whole) if whole else 1.0
