"""Which sessions join: halves of drives, two drives through one hall, and strangers.

python benchmarks/sessions.py [halves] [halls] [strangers] [--data FOLDER] [--keep FOLDER]

Halves: each log is cut in two by time, both are built as maps, and these are merged; the error is
that of the merged map against the reference of the whole log (RMSE of all scans after rigid
alignment for buildings, mean translational error of relations as recorded). Halls: rooms of some
20 x 12 m with random boxes, driven through twice for a minute with a laser of 4 m. Strangers: every
pair of maps made for the other two that shows different places. Pairs marked * were not looked at
while the mechanism was made.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh
from common import DATA
from localisation_logs import Bench, run

from formats.database import open_store
from formats.logs import open_log
from formats.relation_files import read_relations
from formats.trajectory_files import read_trajectory
from mapmyworld.config import Config
from mapmyworld.evaluation.relations_metric import relations_score
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.places.session_joining import locate_session
from mapmyworld.places.session_places import SessionPlaces
from mapmyworld.sessions import load_session_map
from mapmyworld.sessions.joining import session_places
from mapmyworld.types import Trajectory

HALVES = {
    "b-acapulco": False, "b-csail": False, "b-edmonton": False, "b-orebro": False, "fr079": False,
    "b-belgioioso": True, "b-freiburg-101": True, "b-intel": True, "intel": True,
    "mit-csail": True,
}  # fmt: skip
"""Log -> whether it was kept aside."""
HALLS = {1: False, 2: False, 3: False, 4: True, 5: True, 6: True}
ROUTES = (
    "start:0,0,0 14,0 14,6 0,6 0,4",
    "start:14,6,180 0,6 0,0 14,0 14,2",
)


def log_of(bench: Bench, name: str) -> Path:
    folder = bench.data / "laser"
    if name.startswith("b-"):
        return folder / "buildings" / f"{name[2:]}.clf.bz2"
    return folder / f"{name}.clf.bz2"


def half_maps(bench: Bench, name: str) -> list[Path]:
    log = log_of(bench, name)
    half = round((open_log([log]).info().duration_s) / 2.0)
    cut = [("--duration", half), ("--start", half)]
    logs = [bench.make(f"{name}_{k + 1}.mcap", "convert", log, *c) for k, c in enumerate(cut)]
    return [built(bench, made) for made in logs]


def built(bench: Bench, log: Path) -> Path:
    return bench.make(f"{log.stem}.db", "build", log, "--no-export")


def hall_maps(bench: Bench, seed: int) -> list[Path]:
    world = bench.folder / f"hall-{seed}.glb"
    if not world.exists():
        draw_hall(world, np.random.default_rng(seed))
    made = []
    for k, route in enumerate(ROUTES):
        log = bench.make(
            f"hall-{seed}_{k + 1}.mcap", "simulate", "--world", world, "--no-camera", "--seed",
            10 * seed + k, "--route", route, "--set", "laser.range_max=4",
        )  # fmt: skip
        made.append(built(bench, log))
    return made


def draw_hall(path: Path, random: np.random.Generator) -> None:
    """Four walls and boxes beside two lanes, as glTF: y up."""
    west, south = random.uniform(-4.0, -2.0, 2)
    east, north = random.uniform(16.0, 21.0), random.uniform(8.0, 11.0)
    x, y, wide, deep = (west + east) / 2, (south + north) / 2, east - west, north - south
    boxes = [(west, y, 0.1, deep), (east, y, 0.1, deep), (x, south, wide, 0.1),
             (x, north, wide, 0.1)]  # fmt: skip
    for low, high, count in ((1.6, 4.4, 6), (-2.6, -1.6, 4), (7.6, 8.6, 4)):
        for _ in range(count):
            x, y = random.uniform(1.5, 12.5), random.uniform(low, high)
            boxes.append((x, y, *random.uniform(0.2, 1.0, 2)))
    solids = [trimesh.creation.box((30.0, 0.1, 20.0))]
    solids[0].apply_translation((7.0, -0.05, -3.0))
    for x, y, wide, deep in boxes:
        solid = trimesh.creation.box((wide, 2.0, deep))
        solid.apply_translation((x, 1.0, -y))
        solids.append(solid)
    trimesh.util.concatenate(solids).export(path)


def merged(bench: Bench, name: str, maps: list[Path]) -> tuple[Path | None, float]:
    """The map that both became, if they joined, and CPU seconds."""
    out, begun = bench.folder / f"{name}_merged.db", time.process_time()
    for old in bench.folder.glob(f"{name}_merged*"):
        old.unlink()
    code = run("merge", *maps, "-o", out, "--no-export")
    return (out if code == 0 else None), time.process_time() - begun


def error_of(bench: Bench, name: str, path: Path) -> str:
    with open_store(path, read_only=True) as store:
        poses, stamps = store.frame_poses(), store.tracked_frames().stamps_ns
    assert poses is not None
    order = np.argsort(stamps, kind="stable")
    estimate, log = Trajectory(stamps[order], poses[order]), log_of(bench, name)
    reference = log.with_name(log.name.replace(".clf.bz2", ".ref.tum"))
    relations = log.with_name(log.name.replace(".clf.bz2", ".relations"))
    if reference.exists():
        return f"{ate(estimate, read_trajectory(reference)).rmse:.3f}"
    if relations.exists():
        return f"{relations_score(estimate, read_relations(relations)).translation.mean:.4f}"
    return ""


def truth_error(maps: list[Path], path: Path) -> str:
    """Metres, RMSE of both drives of a hall, aligned together."""
    truths = [read_trajectory(Path(f"{m.with_suffix('.mcap')}.truth") / "trajectory.tum")
              for m in maps]  # fmt: skip
    with open_store(path, read_only=True) as store:
        poses, frames, nodes = store.frame_poses(), store.tracked_frames(), store.nodes()
    assert poses is not None
    session = {node.id: node.session for node in nodes}
    of = np.array([session[int(i)] for i in frames.node_ids])
    shift = [0, 10**15]  # both drives begin at the same simulated moment
    stamps = frames.stamps_ns + np.array(shift)[of]
    whole = Trajectory(
        np.concatenate([t.stamps_ns + s for t, s in zip(truths, shift, strict=True)]),
        np.concatenate([t.poses for t in truths]),
    )
    return f"{ate(Trajectory(stamps, poses), whole).rmse:.4f}"


def row(name: str, aside: bool, wanted: str, came: str, error: str, cpu_s: float) -> None:
    right = "" if wanted == came else " **wrong**"
    mark = "*" if aside else ""
    print(f"| {name}{mark} | {wanted} | {came}{right} | {error} | {cpu_s:.1f} |", flush=True)


def halves(bench: Bench) -> None:
    for name, aside in HALVES.items():
        path, cpu_s = merged(bench, name, half_maps(bench, name))
        error = "" if path is None else error_of(bench, name, path)
        row(f"{name}, halves", aside, "join", "apart" if path is None else "join", error, cpu_s)


def halls(bench: Bench) -> None:
    for seed, aside in HALLS.items():
        maps = hall_maps(bench, seed)
        path, cpu_s = merged(bench, f"hall-{seed}", maps)
        error = "" if path is None else truth_error(maps, path)
        row(f"hall {seed}, 4 m", aside, "join", "apart" if path is None else "join", error, cpu_s)


def strangers(bench: Bench) -> None:
    for first in (0, 1):
        strange_pairs(bench, first)


def strange_pairs(bench: Bench, first: int) -> None:
    """One of the two maps of each place, every other place's `first` or the other one; how many
    pairs there were and which joined, in one row or more.
    """
    names = {n: half_maps(bench, n)[(k + first) % 2] for k, n in enumerate(HALVES)}
    names |= {f"hall-{seed}": hall_maps(bench, seed)[(seed + first) % 2] for seed in HALLS}
    known: dict[str, SessionPlaces] = {}
    for name, path in names.items():
        with open_store(path, read_only=True) as store:
            known[name] = session_places(load_session_map(name, store), bench.config)
            known[name] = held(known[name])
    same = {frozenset(("b-intel", "intel")), frozenset(("b-csail", "mit-csail"))}
    count = false = 0
    begun = time.process_time()
    for a, b in itertools.combinations(names, 2):
        if frozenset((a, b)) in same:
            continue
        count += 1
        if locate_session(known[a], known[b]) is not None:
            false += 1
            row(f"{a} and {b}", False, "apart", "join", "", 0.0)
    spent = time.process_time() - begun
    row(f"strangers, {count} pairs, {false} joined", first == 1, "apart", "apart", "", spent)


def held(session: SessionPlaces) -> SessionPlaces:
    """With its map and its places made, for its store is closed."""
    assert session.whole.points.any()
    assert len(session.places)
    return session


CASES = {"halves": halves, "halls": halls, "strangers": strangers}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("cases", nargs="*", default=list(CASES))
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--keep", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        bench = Bench(folder, arguments.data, Config())
        print("| maps | wanted | came | error m | CPU s |\n| --- | --- | --- | --- | --- |")
        for case in arguments.cases:
            CASES[case](bench)


if __name__ == "__main__":
    main()
