"""Laser mapping on logs that nobody tuned for: one row a log, all with the default settings.

python benchmarks/unseen.py [LOG...] [--data FOLDER] [--set KEY=VALUE] [--method fastslam]
python benchmarks/unseen.py [LOG...] --altered half stall,gap,people --seeds 13 14

A LOG is a name below, all by default, or a file. Altered ones are each building, or LOG beside its
reference, changed as `laser_altered.py` names it, once a seed; several ways at once with commas.
Errors are RMSE of all scans after the best rigid alignment
for buildings with a reference trajectory, and the mean translational error for logs with relations.
A closure is false where it misses the reference by more than 0.5 m or 5 degrees. Recall: of the
moments at which the robot is back within 1 m and 30 degrees of an earlier visit, the share that an
accepted closure joins to it within 2 m of path. NEES: of nodes, per unknown; 1 is consistent where
the reference is the truth.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from common import DATA
from laser_altered import altered
from laser_recall import closures_of, recalled, returns

from formats.database import MemoryMap
from formats.logs import open_log
from formats.relation_files import read_relations
from formats.trajectory_files import read_trajectory
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.evaluation.nees import map_nees
from mapmyworld.evaluation.relations_metric import poses_at, relations_score
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.graph.variance import normalised_residuals
from mapmyworld.map_figures import calibrated_constraints
from mapmyworld.pipeline import build_map
from mapmyworld.types import CLOSURES, MapStore, Trajectory

BUILDINGS = ("acapulco", "belgioioso", "csail", "edmonton", "freiburg-101", "intel", "orebro")
LOGS = {
    **{name: f"laser/buildings/{name}.clf.bz2" for name in BUILDINGS},
    "intel-as-recorded": "laser/intel.clf.bz2",
    "fr079": "laser/fr079.clf.bz2",
    "mit-csail": "laser/mit-csail.clf.bz2",
    "clinic": "laser/fr-clinic.clf.bz2",
    "ual": "laser/ual.mcap",
}
_FALSE = (0.5, 5.0)  # m and degrees from which a closure is false


@dataclass
class Row:
    """What came of one log."""

    error: float
    losses: list[str]
    accepted: int
    tried: int
    false: int
    recall: float
    normalised: dict[str, float]
    nees: float
    cpu_s: float
    realtime: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("logs", nargs="*")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--method", default="graph")
    parser.add_argument("--grid", type=Path, help="folder for a picture of each map")
    parser.add_argument("--altered", nargs="+", metavar="KIND[,KIND]", help="ways to change logs")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], help="one version for each")
    arguments = parser.parse_args()
    config = apply_settings(Config(), dict(s.split("=", 1) for s in arguments.set))
    print(
        f"{'log':<37}{'error m':>9}{'closures':>12}{'false':>6}{'recall':>8}"
        f"{'nbr':>6}{'loop':>6}{'NEES':>7}{'CPU s':>8}{'x real':>8}{'MB':>6}  losses"
    )
    with tempfile.TemporaryDirectory(prefix="altered-") as made:
        for name, path in _logs(arguments, Path(made)):
            row = run(path, config, arguments.method, arguments.grid, name)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
            n = [row.normalised.get(k, float("nan")) for k in ("neighbour", "loop_closure")]
            print(
                f"{name:<37}{row.error:9.4f}{row.accepted:6d}/{row.tried:<5d}{row.false:6d}"
                f"{row.recall:8.1%}{n[0]:6.2f}{n[1]:6.2f}{row.nees:7.2f}{row.cpu_s:8.1f}"
                f"{row.realtime:8.0f}{peak:6d}  {'; '.join(row.losses)[:120]}",
                flush=True,
            )


def _logs(arguments: argparse.Namespace, folder: Path) -> Iterator[tuple[str, Path]]:
    """Names and files of the logs; altered ones are written to the folder."""
    names = arguments.logs or list(BUILDINGS if arguments.altered else LOGS)
    files = [arguments.data / LOGS[name] if name in LOGS else Path(name) for name in names]
    names = [
        n if n in LOGS else file.name.split(".")[0] for n, file in zip(names, files, strict=True)
    ]
    if not arguments.altered:
        yield from zip(names, files, strict=True)
        return
    for kinds, seed in product(arguments.altered, arguments.seeds):
        for name, file in zip(names, files, strict=True):
            reference = file.with_name(file.name.split(".clf")[0] + ".ref.tum")
            title = f"{name}-{kinds}-{seed}"
            yield title, altered(file, reference, folder / title, kinds.split(","), seed)


def run(path: Path, config: Config, method: str, pictures: Path | None, name: str) -> Row:
    """One log built and judged."""
    store, silent = MemoryMap(), Silent()
    log = open_log([path])
    begun = time.process_time()
    result = build_map(log, store, config, silent, method=method)
    cpu_s = time.process_time() - begun
    reference = _reference(path)
    closures = [c for c in store.constraints() if c.kind in CLOSURES]
    kept = [c for c in closures if c.accepted]
    solved = store.poses()
    assert solved is not None
    if pictures is not None:
        _picture(store, pictures / f"{name}.png")
    return Row(
        _error(store, path, reference),
        list(result.losses),
        len(kept),
        len(closures),
        _false(store, reference),
        _recall(store, reference),
        normalised_residuals(calibrated_constraints(store), solved, planar=True),
        _nees(store, reference),
        cpu_s,
        result.duration_s / max(cpu_s, 1e-9),
    )


def _reference(path: Path) -> Trajectory | None:
    file = path.with_name(path.name.split(".clf")[0] + ".ref.tum")
    return read_trajectory(file) if file.exists() else None


def _estimate(store: MapStore) -> Trajectory:
    frames = store.frame_poses()
    assert frames is not None
    return Trajectory(store.tracked_frames().stamps_ns, frames)


def _error(store: MapStore, path: Path, reference: Trajectory | None) -> float:
    """Metres; NaN without a reference."""
    if reference is not None:
        return ate(_estimate(store), reference).rmse
    relations = path.with_name(path.name.split(".clf")[0] + ".relations")
    if relations.exists():
        return relations_score(_estimate(store), read_relations(relations)).translation.mean
    return float("nan")


def _false(store: MapStore, reference: Trajectory | None) -> int:
    """Accepted closures that the reference contradicts."""
    kept = [c for c in store.constraints() if c.kind in CLOSURES and c.accepted]
    if reference is None or not kept:
        return 0
    stamp = {node.id: node.stamp_ns for node in store.nodes()}
    first, second = (
        poses_at(reference, np.array([stamp[i] for i in ids], np.int64))
        for ids in ([c.from_id for c in kept], [c.to_id for c in kept])
    )
    miss = between(between(first, second), np.stack([c.i_from_j for c in kept]))
    far = np.linalg.norm(miss[:, :3, 3], axis=1) > _FALSE[0]
    return int(np.count_nonzero(far | (np.degrees(rotation_angle(miss)) > _FALSE[1])))


def _recall(store: MapStore, reference: Trajectory | None) -> float:
    """Share of the moments back that closures join; by the map's own poses without a reference."""
    nodes, solved = store.nodes(), store.poses()
    assert solved is not None
    stamps = np.maximum.accumulate(np.array([node.stamp_ns for node in nodes], np.int64))
    poses = matrix_to_planar(solved.map_from_node[solved.ids > 0])
    if reference is not None:
        poses = matrix_to_planar(poses_at(reference, stamps))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    pairs = returns(poses, path)
    if len(pairs) == 0 or not any(c.accepted and c.kind in CLOSURES for c in store.constraints()):
        return float("nan") if len(pairs) == 0 else 0.0
    found = recalled(closures_of(store, path), path[pairs])
    return len(np.unique(pairs[found, 1])) / len(np.unique(pairs[:, 1]))


def _nees(store: MapStore, reference: Trajectory | None) -> float:
    """NaN without a reference."""
    solved = store.poses()
    assert solved is not None
    found = map_nees(store.nodes(), solved, reference) if reference is not None else None
    return float("nan") if found is None else found


def _picture(store: MapStore, file: Path) -> None:
    from matplotlib import pyplot

    grid = store.grid()
    assert grid is not None
    file.parent.mkdir(parents=True, exist_ok=True)
    pyplot.imsave(file, np.flipud(grid.log_odds), cmap="gray_r", vmin=-2, vmax=2)


if __name__ == "__main__":
    main()
