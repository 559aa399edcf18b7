"""A machine on which Open3D does not load: only meshes are missing, and they say so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

from cli.export import export
from mapmyworld.open3d_library import PACKAGES

EXPORTS = sorted(set(export.commands) - {"mesh"})


class BareMachine:
    """Commands in processes of their own, in which the import of Open3D fails."""

    def __init__(self, folder: Path) -> None:
        self.folder, hidden = folder, folder / "hidden"
        hidden.mkdir()
        (hidden / "open3d.py").write_text("raise ImportError('libusb-1.0.so.0 is not there')\n")
        self.environment = os.environ | {"PYTHONPATH": f"{hidden}:{ROOT}"}

    def run(self, *words: str, code: int = 0) -> str:
        """What the command says on stderr."""
        done = subprocess.run(
            [sys.executable, "-m", "cli.main", *words],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert done.returncode == code, done.stderr
        return done.stderr


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> BareMachine:
    """With a log that has images, and its map."""
    made = BareMachine(tmp_path_factory.mktemp("bare"))
    made.run("simulate", "apartment", "--route", "1.5,0", "--laps", "1", "-o", "flat.mcap", "-q")
    made.run("build", "flat.mcap", "-o", "map.db", "-q")
    return made


def test_a_simulated_camera_is_mapped(machine: BareMachine) -> None:
    assert {"map.db", "map.pgm", "map.ply", "map.html"} <= set(os.listdir(machine.folder))
    machine.run("doctor")


@pytest.mark.parametrize("what", EXPORTS)
def test_every_export_but_the_mesh_is_written(machine: BareMachine, what: str) -> None:
    output = machine.folder / f"out-{what}"
    suffix = {"cloud": ".pcd", "figure": ".png", "mcap": ".mcap"}.get(what, "")
    machine.run("export", what, "map.db", "-o", f"{output.name}{suffix}", "-q")
    assert list(machine.folder.glob(f"{output.name}*"))


def test_a_mesh_says_what_to_install(machine: BareMachine) -> None:
    reported = machine.run("export", "mesh", "map.db", "-o", "mesh.ply", "-q", code=2)
    (line,) = reported.splitlines()
    assert f"`apt-get install {PACKAGES}`" in line


def test_a_mesh_of_ones_own_is_driven_through(machine: BareMachine) -> None:
    (machine.folder / "room.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    world = ("simulate", "--world", "room.obj", "--route", "start:0,0,0 1,0")
    machine.run(*world, "-o", "room.mcap", "-q")
