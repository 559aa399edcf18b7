"""How well a log is localised in a finished map, and how sessions join.

python benchmarks/localisation.py [CASE...] [--data FOLDER] [--keep FOLDER] [--set KEY=VALUE]

Cases: apartment, kidnap, intel, fr079, neato, grid, merge, office; all but office when none is
named. Maps and logs are made in a folder that `--keep` names, and used again where they lie there.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cli.main import group
from formats.database import open_store
from formats.grid import read_grid
from formats.logs import open_log
from formats.trajectory import read_trajectory
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.geometry import between, interpolate, rotation_angle
from mapmyworld.localisation import localise_log, plan_log
from mapmyworld.types import Trajectory
from mapmyworld.types.localisation import Localisation, State

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("MAPMYWORLD_DATA", ROOT.parent / "shared" / "data"))
_FAR = 0.5  # m: a pose that is claimed and farther off is false


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None: ...


@dataclass(frozen=True)
class Bench:
    """Where things are made, and with which settings."""

    folder: Path
    data: Path
    config: Config

    def make(self, name: str, *arguments: object) -> Path:
        """A file of the folder, made by one of the program's commands unless it is there."""
        path = self.folder / name
        if not path.exists():
            run(*arguments, "-o", path)
        return path

    def simulated(self, name: str, world: str, *more: object) -> Path:
        return self.make(f"{name}.mcap", "simulate", world, "--no-camera", *more)

    def built(self, name: str, log: Path) -> Path:
        return self.make(f"{name}.db", "build", log)

    def localised(self, where: Path, log: Path) -> tuple[Localisation, float]:
        """What was found, and the CPU seconds that it took."""
        source, begun = open_log([log]), time.process_time()
        plan = plan_log(source, self.config, Silent())
        if where.suffix == ".yaml":
            found = localise_log(read_grid(where), source, plan, self.config, Silent())
        else:
            with open_store(where, read_only=True) as store:
                found = localise_log(store, source, plan, self.config, Silent())
        return found, time.process_time() - begun


def run(*arguments: object) -> int:
    """The exit code of one of the program's commands."""
    try:
        group.main([*map(str, arguments), "-q"], standalone_mode=False)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def report(name: str, found: Localisation, cpu_s: float, reference: Trajectory) -> None:
    """One row: how much was claimed, how right it was, and its cost."""
    stamps = np.array([e.stamp_ns for e in found.estimates])
    poses = np.stack([e.map_from_base for e in found.estimates])
    claimed = np.array([e.state != State.LOST for e in found.estimates])
    off = between(at_stamps(reference, stamps), poses)
    metres = np.linalg.norm(off[:, :2, 3], axis=1)[claimed]
    degrees = np.degrees(rotation_angle(off))[claimed]
    duration = (stamps.max() - stamps.min()) * 1e-9
    first = found.recognised_after_s
    print(
        f"| {name} | {'never' if first is None else f'{first:.1f}'} | {claimed.mean():.1%} | "
        f"{np.median(metres):.4f} | {np.percentile(metres, 95):.4f} | {metres.max():.3f} | "
        f"{np.median(degrees):.2f} | {np.count_nonzero(metres > _FAR)} | {found.times_lost} | "
        f"{duration / cpu_s:.0f} |",
        flush=True,
    )


def head() -> None:
    columns = ("log in map", "found after s", "claimed", "median m", "95 % m", "max m",
               "median deg", "false", "lost again", "x real time")  # fmt: skip
    print(f"| {' | '.join(columns)} |")
    print(f"|{' --- |' * len(columns)}")


def at_stamps(path: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of a path at stamps, in its own order where that is not the stamps'."""
    order = np.argsort(path.stamps_ns, kind="stable")
    known, poses = path.stamps_ns[order], path.poses[order]
    after = np.clip(np.searchsorted(known, stamps), 1, len(known) - 1)
    span = np.maximum(known[after] - known[after - 1], 1)
    share = np.clip((stamps - known[after - 1]) / span, 0.0, 1.0)
    return interpolate(poses[after - 1], poses[after], share)


def apartment(bench: Bench) -> None:
    known = bench.built("flat", bench.simulated("flat", "apartment"))
    for seed in (1, 2, 3):
        log = bench.simulated(f"second_{seed}", "apartment", "--route", "second", "--seed", seed)
        truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
        report(f"apartment, second start, seed {seed}", *bench.localised(known, log), truth)


def kidnap(bench: Bench) -> None:
    known = bench.built("flat", bench.simulated("flat", "apartment"))
    for seed in (2, 3, 4):
        log = bench.simulated(f"kidnap_{seed}", "apartment", "--route", "kidnap", "--seed", seed)
        truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
        found, cpu_s = bench.localised(known, log)
        report(f"apartment, kidnapped, seed {seed}", found, cpu_s, truth)
        show_kidnapping(found, truth)


def show_kidnapping(found: Localisation, truth: Trajectory) -> None:
    """When the robot was carried, when that was noticed, and when its place was found again."""
    steps = np.linalg.norm(np.diff(truth.poses[:, :2, 3], axis=0), axis=1)
    carried = int(truth.stamps_ns[int(np.argmax(steps)) + 1])
    after = [e for e in found.estimates if e.stamp_ns >= carried - 150_000_000]
    lost = next((e.stamp_ns for e in after if e.state == State.LOST), None)
    if lost is None:
        print("  not noticed")
        return
    again = next((e.stamp_ns for e in after if e.stamp_ns > lost and e.state != State.LOST), None)
    back = "never" if again is None else f"{(again - carried) * 1e-9:.1f} s"
    print(f"  noticed after {max(lost - carried, 0) * 1e-9:.1f} s, found again after {back}")


def halves(name: str, seconds: int) -> Callable[[Bench], None]:
    """The map of a log's first half, its second half in it; the truth is the whole log's map."""

    def run(bench: Bench) -> None:
        log = bench.data / "laser" / f"{name}.clf.bz2"
        first = bench.make(f"{name}_1.mcap", "convert", log, "--duration", seconds)
        second = bench.make(f"{name}_2.mcap", "convert", log, "--start", seconds)
        half, whole = bench.built(f"{name}_1", first), bench.built(name, log)
        with open_store(whole, read_only=True) as store:
            final = store.frame_poses()
            assert final is not None
            path = Trajectory(store.tracked_frames().stamps_ns, final)
        report(f"{name}, second half", *bench.localised(half, second), path)

    return run


def neato(bench: Bench) -> None:
    """A grid that another program made while it localised the same robot."""
    log = bench.data / "bags" / "neato_with_particle_filter.bag"
    where = grid_of_bag(log, bench.folder / "neato.yaml")
    found, cpu_s = bench.localised(where, log)
    fits = [e.fit for e in found.estimates if e.state != State.LOST]
    print(
        f"neato in a grid of another program: found after {found.recognised_after_s} s (it stands "
        f"for 16 s), claimed {1 - found.share(State.LOST):.1%}, scans agree with the grid by "
        f"{np.median(fits):.1%} (median), {cpu_s:.1f} CPU s"
    )


def grid_of_bag(log: Path, path: Path) -> Path:
    """The first grid on a ROS 1 bag's /map as a YAML file with its picture."""
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    with Reader(log) as reader:
        wanted = [c for c in reader.connections if c.topic == "/map"]
        connection, _, raw = next(reader.messages(wanted))
        message: Any = types.deserialize_ros1(raw, connection.msgtype)
    write_occupancy(path, message)
    return path


def write_occupancy(path: Path, message: Any) -> None:
    """A nav_msgs/OccupancyGrid as map_server saves it."""
    info = message.info
    cells = np.array(message.data, np.int8).reshape(info.height, info.width)
    grey = np.full(cells.shape, 205, np.uint8)
    grey[cells == 0], grey[cells == 100] = 254, 0
    header = f"P5\n{info.width} {info.height}\n255\n".encode()
    path.with_suffix(".pgm").write_bytes(header + grey[::-1].tobytes())
    x, y = info.origin.position.x, info.origin.position.y
    path.write_text(
        f"image: {path.stem}.pgm\nresolution: {info.resolution}\norigin: [{x}, {y}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def grid(bench: Bench) -> None:
    """The same drives against the bare PGM and YAML."""
    bench.built("flat", bench.simulated("flat", "apartment"))
    log = bench.simulated("second_1", "apartment", "--route", "second", "--seed", 1)
    truth = read_trajectory(Path(f"{log}.truth") / "trajectory.tum")
    found = bench.localised(bench.folder / "flat.yaml", log)
    report("apartment, second start, bare grid of ours", *found, truth)
    perfect = bench.folder / "flat.mcap.truth" / "grid.yaml"
    report("apartment, second start, true grid", *bench.localised(perfect, log), truth)


def merge(bench: Bench) -> None:
    """Two sessions of one flat; then a flat and a hall."""
    flat = bench.built("flat", bench.simulated("flat", "apartment"))
    second = bench.built(
        "second_1", bench.simulated("second_1", "apartment", "--route", "second", "--seed", 1)
    )
    hall = bench.built("hall", bench.simulated("hall", "hall"))
    for name, maps in (("flat + second", (flat, second)), ("second + flat", (second, flat)),
                       ("flat + hall", (flat, hall))):  # fmt: skip
        out = bench.folder / f"{name.replace(' ', '')}.db"
        with cost() as spent:
            code = run("merge", *maps, "-o", out, "--no-export")
        print(f"merge {name}: exit code {code}; {spent()}")
    ordered = [(bench.folder / f"{n}.db").read_bytes() for n in ("flat+second", "second+flat")]
    print("any order, the same bytes:", ordered[0] == ordered[1])


def office(bench: Bench) -> None:
    """Ten sessions of one office, added one after the other."""
    known = bench.folder / "office.db"
    known.unlink(missing_ok=True)
    for seed in range(10):
        route = ("default", "second")[seed % 2]
        log = bench.simulated(
            f"office_{seed}", "office", "--route", route, "--laps", 1, "--seed", seed,
            "--set", "laser.rate=5", "--set", "laser.beams=361",
        )  # fmt: skip
        with cost() as spent:
            run("build", "--append", known, log, "--no-export")
        print(f"session {seed + 1}: {spent()}, {known.stat().st_size / 1e6:.0f} MB", flush=True)


@contextmanager
def cost() -> Any:
    """Gives the CPU seconds of a block and the peak memory of this process, as text."""
    told: list[str] = []
    begun = time.process_time()
    yield lambda: told[0]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    told.append(f"{time.process_time() - begun:.1f} CPU s, {peak:.0f} MB at most")


CASES: dict[str, Callable[[Bench], None]] = {
    "apartment": apartment,
    "kidnap": kidnap,
    "grid": grid,
    "intel": halves("intel", 1345),
    "fr079": halves("fr079", 530),
    "neato": neato,
    "merge": merge,
    "office": office,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[[], *CASES], help="what to run")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--keep", type=Path, help="folder for maps and logs")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    changes = dict(change.split("=", 1) for change in options.changes)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bench = Bench(folder, options.data, apply_settings(Config(), changes))
        head()
        for case in options.cases or [name for name in CASES if name != "office"]:
            CASES[case](bench)


if __name__ == "__main__":
    main()
