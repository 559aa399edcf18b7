"""What is installed, what it may import, and how fast the command line answers."""

from __future__ import annotations

import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT

# Modules that take long to import, or need system libraries, and their reason to stay away.
HEAVY = ("numba", "gtsam", "cv2", "open3d", "scipy", "rosbags", "mcap")


@pytest.mark.slow
def test_the_wheel_holds_exactly_the_three_packages(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("*.whl")
    names = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    packages = {name for name in names if not name.endswith(".dist-info")}
    assert packages == {"mapmyworld", "cli", "formats"}
    inside = zipfile.ZipFile(wheel).namelist()
    assert all(f"{package}/py.typed" in inside for package in packages)


def test_import_layers_hold() -> None:
    found = subprocess.run(
        [str(Path(sys.executable).with_name("lint-imports"))],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert found.returncode == 0, found.stdout


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, cli.main; from click.testing import CliRunner;"
        "assert CliRunner().invoke(cli.main.group, ['--help']).exit_code == 0;"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        timeout=300,
    )
    assert found.stdout.strip() == "[]"


def test_help_answers_at_once() -> None:
    """0.2 s by the docs, in seconds of the processor: others may want it as well."""

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return children.ru_utime + children.ru_stime

    def run() -> float:
        before = used()
        subprocess.run(
            [sys.executable, "-m", "cli.main", "--help"],
            check=True,
            capture_output=True,
            cwd=ROOT,
            timeout=300,
        )
        return used() - before

    assert min(run() for _ in range(5)) < 0.2


def test_building_and_simulating_never_import_open3d() -> None:
    code = (
        "import sys, mapmyworld.pipeline, formats.logs, formats.database, cli.build;"
        "import mapmyworld.exporting;"
        "import mapmyworld.simulation.simulated_camera;"
        "print('open3d' in sys.modules)"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        timeout=300,
    )
    assert found.stdout.strip() == "False"
