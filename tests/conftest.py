"""What all tests share: where the recorded data lie."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from browser import browser  # noqa: F401  one for all: a process runs one Playwright
from hypothesis import settings

from mapmyworld.open3d_library import PACKAGES

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("MAPMYWORLD_DATA", ROOT.parent / "shared" / "data"))

# No deadline: a busy machine is no failure. New examples every time, where CI is set as well: a
# failure prints the example, and `make test` the seed, with which it is replayed.
settings.register_profile("any machine", deadline=None, derandomize=False, print_blob=True)
settings.load_profile("any machine")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of recorded logs, graphs and databases; skips where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"recorded data not found at {DATA}: set MAPMYWORLD_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def open3d() -> Any:
    """The library; skips where it does not load."""
    wanted = f"Open3D does not load: `apt-get install {PACKAGES}`"
    return pytest.importorskip("open3d", exc_type=ImportError, reason=wanted)
