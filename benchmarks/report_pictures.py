"""The pictures of reports in docs/images: what a person sees of a page, and its print.

    python benchmarks/report_pictures.py apartment.html intel.html broken.html -o docs/images

Needs Playwright's Python package and a Chromium; pictures are kept under 300 kB.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np

_BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_DESKTOP = {"width": 1200, "height": 900}
_PHONE = {"width": 390, "height": 844}
_MOST_BYTES = 300_000


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("pages", nargs="+", type=Path, metavar="PAGE.html")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    path = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    options.output.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_FLAGS)
        for page in options.pages:
            sections(browser, page, options.output, f"report-{page.stem}")
            window = opened(browser, page)
            window.pdf(path=options.output / f"report-{page.stem}.pdf", format="A4")
            window.close()
        browser.close()


if __name__ == "__main__":
    main()
