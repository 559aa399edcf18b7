"""Maps of buildings drawn at random, as robots of the year 2000 recorded them, and their scores.

    python benchmarks/laser_buildings.py 0 12                   # buildings 0 to 11
    python benchmarks/laser_buildings.py 3 --keep FOLDER        # with log, truth, map and grid kept
    python benchmarks/laser_buildings.py 100 --bare             # long bare corridors

See buildings.py for what is drawn and building_drives.py for how it is recorded. Each CARMEN log
is built with the default configuration and compared with the truth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from building_drives import write_log
from common import scores_of, tool
from laser_recall import closures_of, drive_of, recalled, returns
from numpy.typing import NDArray

from formats.database import open_store
from mapmyworld.geometry.planar import between_planar, wrap_angle

Array = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("end", type=int, nargs="?", help="one beyond the last; one without")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where logs and maps stay")
    parser.add_argument("--bare", action="store_true", help="long corridors that show little")
    parser.add_argument("--config", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    titles = "building|m|path m|loop m|Hz|res m|odometry|ATE m|max m|deg|relation m|deg"
    titles += "|closures|wrong|recall|CPU s|MB|x real time"
    print("| " + titles.replace("|", " | ") + " |\n" + "| --- " * (titles.count("|") + 1) + "|")
    with tempfile.TemporaryDirectory(prefix="buildings-") as made:
        folder = options.keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(options.first, options.end or options.first + 1):
            print(row(number, folder, options.config, bare=options.bare), flush=True)


def row(number: int, folder: Path, changes: list[str], *, bare: bool) -> str:
    """One building's line of the table."""
    log, built = folder / f"{number}.log", folder / f"{number}.db"
    truth = folder / f"{number}.truth.tum"
    if not (log.exists() and truth.exists()):
        head = write_log(number, log, truth, bare=bare)
        log.with_suffix(".head").write_text(head)
    head = log.with_suffix(".head").read_text()
    words = [word for change in changes for word in ("--set", change)]
    command = ["build", log, "-o", built, "--overwrite", "--format", "json", *words]
    done = tool(*command)
    if done.returncode:
        return f"{head} | exit code {done.returncode}: {done.stderr.strip()[-200:]} |"
    cost = json.loads(done.stdout)
    path, loops = scores_of(built, truth).values()
    wrong = round(loops["count"] * (1.0 - loops["precision"]))
    ate = path["ate"]
    far, turned, recall = by_truth(built, truth)
    return (
        f"{head} | {ate['rmse']:.4f} | {ate['maximum']:.3f} | "
        f"{path['ate_rotation_deg']['rmse']:.2f} | {far:.4f} | {turned:.3f} | "
        f"{loops['count']} | {wrong} | {recall:.1%} | {cost['cpu_s']:.1f} | "
        f"{cost['peak_memory_mb']:.0f} | {cost['real_time_factor']:.0f} |"
    )


def by_truth(built: Path, truth: Path) -> tuple[float, float, float]:
    """Mean error of relations, m and deg, and the share of returns that closures recall."""
    store = open_store(built)
    stamps, poses, _ = drive_of(store)
    table = np.loadtxt(truth)
    rows = np.searchsorted(table[:, 0] * 1e9, stamps - 1000).clip(0, len(table) - 1)
    true = np.column_stack([table[rows, 1:3], 2.0 * np.arctan2(table[rows, 6], table[rows, 7])])
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(true[:, :2], axis=0).T))])
    few = np.unique(np.searchsorted(path, np.arange(0.0, path[-1], 0.25)).clip(0, len(path) - 1))
    back = few[returns(true[few], path[few])]
    found = recalled(closures_of(store, path), path[back])
    share = len(np.unique(back[found, 1])) / max(1, len(np.unique(back[:, 1])))
    every = np.linspace(0, len(back) - 1, min(2000, len(back))).astype(np.int64)
    ahead = np.searchsorted(path, path + 1.0).clip(0, len(path) - 1)
    pairs = np.concatenate([back[every], np.stack([np.arange(len(path)), ahead], axis=1)])
    error = between_planar(relative(true, pairs), relative(poses, pairs))
    turned = np.degrees(np.abs(wrap_angle(error[:, 2])))
    return float(np.hypot(*error[:, :2].T).mean()), float(turned.mean()), share


def relative(poses: Array, pairs: NDArray[np.int64]) -> Array:
    """(P, 3) the second pose of each pair seen from the first."""
    return np.asarray(between_planar(poses[pairs[:, 0]], poses[pairs[:, 1]]))


if __name__ == "__main__":
    main()
