"""What a report weighs and how soon it stands: by default of 1,000 nodes with images.

    python benchmarks/report_size.py [MAP.db ...] [--images 1000] [--folder KEPT]

Without a map one is made: that of the sample apartment, its nodes repeated as if the robot had gone
round until so many hold an image, each round tied to the one before by a closure at every node.
Prints CPU seconds of `export report`, the page's size, how long headless Chromium takes from asking
for the file to the first paint and to the finished script, and the CPU seconds of all its processes
until then; the median of several runs.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT
from report_pictures import launched

from formats.database import open_store
from mapmyworld.types import (
    ConstraintKind,
    Judge,
    Judged,
    Poses,
    ScanMatch,
    TrackedFrames,
    Verdict,
    Why,
)

SAMPLE = ROOT / "sample_logs" / "apartment.mcap"
_TIMES = """() => {
  const paint = performance.getEntriesByName("first-contentful-paint")[0];
  return [paint ? paint.startTime : NaN, performance.now()];
}"""


def run(*words: str | Path) -> float:
    """CPU seconds of a command of ours."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "cli.main", *map(str, words)], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def long_drive(folder: Path, images: int) -> Path:
    """A map of so many nodes with images; made once for a folder that is kept."""
    one, found = folder / "one.db", folder / "rounds.db"
    if not one.exists():
        run("build", SAMPLE, "-o", one, "-q")
    if not found.exists():
        rounds = -(-images // max(facts(one)[1], 1))
        repeat(one, found, rounds)
        shutil.copy(one.with_suffix(".ply"), found.with_suffix(".ply"))
    return found


def repeat(source: Path, target: Path, rounds: int) -> None:
    """Writes the map as if the same drive had been made so many times in a row."""
    with open_store(source, read_only=True) as old, open_store(target, create=True) as new:
        nodes, poses, frames = old.nodes(), old.poses(), old.tracked_frames()
        step, count = nodes[-1].id, len(frames.stamps_ns)
        length = int(frames.stamps_ns[-1] - frames.stamps_ns[0]) + 100_000_000
        for k in range(rounds):
            for node in nodes:
                again = replace(node, id=node.id + k * step, stamp_ns=node.stamp_ns + k * length)
                new.add_node(again, old.node_data(node.id))
            new.add_constraints([_moved(c, k * step) for c in old.constraints()])
            if k:
                new.add_constraints([_closure(n.id + (k - 1) * step, step) for n in nodes])
        laps = np.repeat(np.arange(rounds), count)
        new.set_tracked_frames(
            TrackedFrames(
                np.tile(frames.stamps_ns, rounds) + laps * length,
                np.tile(frames.node_ids, rounds) + laps * step,
                np.tile(frames.node_from_frame, (rounds, 1, 1)),
                np.tile(frames.is_node, rounds),
            )
        )
        ids = np.concatenate([poses.ids + k * step for k in range(rounds)])
        every = (
            np.tile(values, (rounds, 1, 1)) for values in (poses.map_from_node, poses.covariances)
        )
        new.set_poses(Poses(ids, *every))
        new.set_frame_poses(np.tile(old.frame_poses(), (rounds, 1, 1)))
        new.set_grid(old.grid())
        for key in ("plan", "track", "solve", "diagnosis", "log", "settings"):
            new.put(key, old.get(key))


def _moved(constraint: Judged, by: int) -> Judged:
    return replace(constraint, from_id=constraint.from_id + by, to_id=constraint.to_id + by)


def _closure(node: int, step: int) -> Judged:
    """The same place a round later."""
    information, numbers = np.eye(6) * 1e4, {"overlap": 0.97, "residual": 0.005}
    aligned = Verdict(Judge.LASER, True, Why.SCANS_ALIGNED, numbers)
    kind = ConstraintKind.LOOP_CLOSURE
    return Judged(node, node + step, kind, np.eye(4), information, ScanMatch(), (aligned,))


def opened(page: Path, times: int) -> tuple[float, float, float]:
    """Seconds to the first paint and to the finished script in a fresh window; CPU seconds."""
    from playwright.sync_api import sync_playwright

    rows = []
    with sync_playwright() as playwright:
        browser = launched(playwright)
        session = browser.new_browser_cdp_session()
        for _ in range(times):
            before = _processor(session)
            window = browser.new_page(viewport={"width": 1280, "height": 900})
            window.goto(page.as_uri())
            window.wait_for_selector("html[data-ready]", state="attached")
            paint, ready = window.evaluate(_TIMES)
            rows.append((paint / 1e3, ready / 1e3, _processor(session) - before))
            window.close()
        browser.close()
    paint, ready, processor = (statistics.median(column) for column in zip(*rows, strict=True))
    return paint, ready, processor


def _processor(session: Any) -> float:
    """CPU seconds of the browser's processes so far."""
    found = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return float(sum(process["cpuTime"] for process in found))


def facts(path: Path) -> tuple[int, int]:
    """Nodes of a map, and how many of them hold an image."""
    with open_store(path, read_only=True) as store:
        nodes: Any = store.nodes()
        return len(nodes), sum(bool(store.node_data(node.id).images) for node in nodes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("maps", nargs="*", type=Path, metavar="MAP")
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--folder", type=Path, help="Keep log and map here.")
    parser.add_argument("--times", type=int, default=5)
    options = parser.parse_args()
    print("| map | nodes | with images | report, CPU s | MB | first paint, s | ready, s | CPU s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        for path in options.maps or [long_drive(folder, options.images)]:
            page = Path(temporary) / f"{path.stem}.html"
            processor = run("export", "report", path, "-o", page)
            nodes, seen = facts(path)
            paint, ready, cpu = opened(page, options.times)
            size = page.stat().st_size / 1e6
            print(
                f"| {path.stem} | {nodes:,} | {seen:,} | {processor:.1f} | {size:.2f} "
                f"| {paint:.2f} | {ready:.2f} | {cpu:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
