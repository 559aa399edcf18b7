"""A headless Chromium for pages, where there is one: Debian's package, or Playwright's own."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
# Software rendering, for 3D on machines without a display; the sandbox needs rights root lacks.
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A running browser; skips where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="no playwright: pages not looked at")
    path = next((found for name in _NAMES if (found := shutil.which(name))), None)
    with api.sync_playwright() as playwright:
        try:
            running = playwright.chromium.launch(executable_path=path, args=_FLAGS)
        except api.Error:
            pytest.skip("no Chromium: install Debian's chromium-headless-shell to test the report")
        yield running
        running.close()
