"""A headless Chromium for pages, where there is one: Debian's package, or Playwright's own."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
# Software rendering, for 3D on machines without a display; the sandbox needs rights root lacks.
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_SUGGESTION = (
    "`apt-get install chromium-headless-shell`, or `.venv/bin/playwright install "
    "chromium-headless-shell`"
)


def skip_without_browser(tests: str) -> None:
    """Skips the test, or the whole module where it is called outside of one."""
    if _path() is None:
        pytest.skip(f"{tests}: no browser: {_SUGGESTION}", allow_module_level=True)


def _path() -> str | None:
    system = [found for name in _NAMES if (found := shutil.which(name))]
    kept = (Path.home() / ".cache" / "ms-playwright").glob("chromium*/*/*headless*shell")
    return next(iter([*system, *map(str, kept)]), None)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A running browser; skips where there is none that starts."""
    skip_without_browser("a page is not looked at")
    from playwright import sync_api as api

    with api.sync_playwright() as playwright:
        try:
            running = playwright.chromium.launch(executable_path=_path(), args=_FLAGS)
        except api.Error as error:
            pytest.skip(f"a page is not looked at: {error}: {_SUGGESTION}")
        yield running
        running.close()
