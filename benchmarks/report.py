"""What a report weighs and how soon it stands: by default of 1,000 nodes with images.

    python benchmarks/report.py [MAP.db ...] [--laps 6] [--folder KEPT]

Without a map one is made: the apartment, driven six times round with laser and camera. Prints CPU
seconds of `export report`, the page's size, and how long headless Chromium takes from asking for
the file to the first paint and to the finished script, the median of several runs.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from formats.database import open_store

_BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
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


def long_drive(folder: Path, laps: int) -> Path:
    """A map of many nodes with images; made once for a folder that is kept."""
    log, found = folder / "laps.mcap", folder / "laps.db"
    if not log.exists():
        rate = ("--set", "camera.rate=4")
        run("simulate", "apartment", "--laps", str(laps), *rate, "-o", log, "-q")
    if not found.exists():
        run("build", log, "-o", found, "-q")
    return found


def opened(page: Path, times: int) -> tuple[float, float]:
    """Seconds to the first paint and to the finished script in a fresh browser window."""
    from playwright.sync_api import sync_playwright

    path = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    rows = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_FLAGS)
        for _ in range(times):
            window = browser.new_page(viewport={"width": 1280, "height": 900})
            window.goto(page.as_uri())
            window.wait_for_selector("html[data-ready]", state="attached")
            rows.append(window.evaluate(_TIMES))
            window.close()
        browser.close()
    paint, ready = (statistics.median(column) / 1e3 for column in zip(*rows, strict=True))
    return paint, ready


def facts(path: Path) -> tuple[int, int]:
    """Nodes of a map, and how many of them hold an image."""
    with open_store(path, read_only=True) as store:
        nodes: Any = store.nodes()
        return len(nodes), sum(bool(store.node_data(node.id).images) for node in nodes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("maps", nargs="*", type=Path, metavar="MAP")
    parser.add_argument("--laps", type=int, default=6)
    parser.add_argument("--folder", type=Path, help="Keep log and map here.")
    parser.add_argument("--times", type=int, default=5)
    options = parser.parse_args()
    print("| map | nodes | with images | report, CPU s | MB | first paint, s | ready, s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        for path in options.maps or [long_drive(folder, options.laps)]:
            page = Path(temporary) / f"{path.stem}.html"
            processor = run("export", "report", path, "-o", page)
            nodes, seen = facts(path)
            paint, ready = opened(page, options.times)
            size = page.stat().st_size / 1e6
            print(
                f"| {path.stem} | {nodes:,} | {seen:,} | {processor:.1f} | {size:.2f} "
                f"| {paint:.2f} | {ready:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
