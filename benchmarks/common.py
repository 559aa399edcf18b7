"""What benchmarks share: where the recorded data are, and the program as a user starts it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("MAPMYWORLD_DATA", ROOT.parent / "shared" / "data"))


def tool(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cli.main", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def scores_of(made: Path, truth: Path) -> dict[str, Any]:
    """How near a map's trajectory is to the truth, and how right its closures are."""
    return {
        what: json.loads(tool("evaluate", what, made, truth, "--format", "json").stdout)
        for what in ("trajectory", "loops")
    }
