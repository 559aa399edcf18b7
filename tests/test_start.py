"""How a program starts: what is imported and loaded when."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

BUILD = """
import sys
from pathlib import Path
from cli.main import group
log, folder = map(Path, sys.argv[1:])
group(["build", str(log), "-o", str(folder / "map.db"), "-q"], standalone_mode=False)
assert (folder / "map.html").is_file()
print({"cv2", "scipy.stats"} & set(sys.modules))
"""
KERNEL = """
import numpy as np
from formats.rvl import rvl_decode
assert not rvl_decode(bytes.fromhex("00000083"), 4, 6).any()  # 24 zeros
print("done")
"""


def printed_by(script: str, cache: Path, **others: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        env={"NUMBA_CACHE_DIR": str(cache), "PATH": "/usr/bin:/bin", **others},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_to_open_a_log_takes_no_numba(tmp_path: Path) -> None:
    script = "import sys, cli.build, formats.logs, formats.database; print('numba' in sys.modules)"
    assert printed_by(script, tmp_path) == "False"


def test_kernels_are_kept_on_disk(tmp_path: Path) -> None:
    printed_by(KERNEL, tmp_path)
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")}
    assert kept
    printed_by(KERNEL, tmp_path)
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")} == kept


def test_kernels_run_where_no_folder_may_be_written() -> None:
    """Each start compiles them then."""
    nowhere = Path("/proc/nowhere")
    only = "UserProvidedCacheLocator"
    assert printed_by(KERNEL, nowhere, NUMBA_CACHE_LOCATOR_CLASSES=only) == "done"


def test_kernels_run_where_numba_may_not_compile(tmp_path: Path) -> None:
    printed_by(f"import mapmyworld.kernels.rays\n{KERNEL}", tmp_path, NUMBA_DISABLE_JIT="1")
    assert not list(tmp_path.rglob("*.nbi"))


def test_what_is_tracked_first_takes_no_solver(tmp_path: Path) -> None:
    script = "import sys, mapmyworld.pipeline, mapmyworld.odometry.laser_odometry\n"
    script += "print({'scipy.linalg', 'cv2', 'gtsam'} & set(sys.modules))"
    assert printed_by(script, tmp_path) == "set()"


@pytest.mark.real_log
def test_a_map_by_laser_takes_neither_image_codec_nor_statistics(
    data: Path, tmp_path: Path
) -> None:
    """OpenCV takes 17 MB, of which nothing is needed without images; `scipy.stats` takes 30."""
    log = data / "laser" / "buildings" / "belgioioso.clf.bz2"
    done = subprocess.run(
        [sys.executable, "-c", BUILD, log, tmp_path],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "set()"
