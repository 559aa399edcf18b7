"""The pictures of reports in docs/images: what a person sees of a page, and its print.

    python benchmarks/report_pictures.py    # README's two, of sample_logs/apartment.mcap
    python benchmarks/report_pictures.py apartment.html intel.html broken.html -o docs/images

Needs Playwright's Python package and a Chromium; pictures are kept under 200 kB.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from common import ROOT

_BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_DESKTOP = {"width": 1200, "height": 900}
_PHONE = {"width": 390, "height": 844}
_MOST_BYTES = 200_000


def launched(playwright: Any) -> Any:
    path = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    return playwright.chromium.launch(executable_path=path, args=_FLAGS)


def opened(browser: Any, page: Path, *, dark: bool = False, phone: bool = False) -> Any:
    window = browser.new_page(
        viewport=_PHONE if phone else _DESKTOP,
        color_scheme="dark" if dark else "light",
        is_mobile=phone,
        has_touch=phone,
        device_scale_factor=2 if phone else 1,
    )
    window.goto(page.absolute().as_uri())
    window.wait_for_selector("html[data-ready]", state="attached")
    window.wait_for_timeout(300)
    return window


def keep(path: Path, picture: bytes) -> None:
    """As PNG with as few colours as its size asks for."""
    pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    step = 1
    while True:
        shown = pixels if step == 1 else pixels // step * step + step // 2
        data = bytes(cv2.imencode(".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])
        if len(data) < _MOST_BYTES or step >= 32:
            break
        step *= 2
    path.write_bytes(data)
    print(f"{path}: {len(data) / 1e3:.0f} kB")


def sections(browser: Any, page: Path, folder: Path, stem: str) -> None:
    """The top of the page in four dresses, and its sections that have pictures."""
    for suffix, dress in (("", {}), ("-dark", {"dark": True})):
        window = opened(browser, page, **dress)
        keep(folder / f"{stem}{suffix}.png", window.screenshot(timeout=120_000))
        window.close()
    for suffix, dress in (("-phone", {}), ("-phone-dark", {"dark": True})):
        window = opened(browser, page, phone=True, **dress)
        keep(folder / f"{stem}{suffix}.png", window.screenshot(timeout=120_000))
        window.close()
    window = opened(browser, page)
    for key in ("closures", "the-cloud", "the-log-s-diagnosis"):
        if window.locator(f"#{key}").count():
            window.evaluate("key => document.getElementById(key).scrollIntoView()", key)
            window.wait_for_timeout(1500)
            keep(folder / f"{stem}-{key}.png", window.screenshot(timeout=120_000))
    window.close()


def readme(browser: Any, folder: Path) -> None:
    """README's pictures: the sample log's map as `export figure` draws it, and its report."""
    with tempfile.TemporaryDirectory() as scratch:
        for words in (
            ("build", ROOT / "sample_logs" / "apartment.mcap", "-o", "apartment.db", "-q"),
            ("export", "figure", "apartment.db", "--what", "map", "-o", "map.png"),
        ):
            command = [sys.executable, "-m", "cli.main", *map(str, words)]
            subprocess.run(command, cwd=scratch, check=True)
        keep(folder / "readme-map.png", (Path(scratch) / "map.png").read_bytes())
        window = opened(browser, Path(scratch) / "apartment.html")
        window.set_viewport_size({"width": 1200, "height": 1300})  # down to the map's end
        keep(folder / "readme-report.png", window.screenshot(timeout=120_000))
        window.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE.html")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    options.output.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = launched(playwright)
        if not options.pages:
            readme(browser, options.output)
        for page in options.pages:
            sections(browser, page, options.output, f"report-{page.stem}")
            window = opened(browser, page)
            window.pdf(path=options.output / f"report-{page.stem}.pdf", format="A4")
            window.close()
        browser.close()


if __name__ == "__main__":
    main()
