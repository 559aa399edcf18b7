"""Names of files that are no UTF-8, and names that the locale cannot hold."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from room_drive import drive

from formats.grid_files import read_grid, write_grid
from formats.report.map_axes import caption
from formats.whole_files import utf8_of
from mapmyworld.types import OccupancyGrid

LATIN = os.fsdecode(b"caf\xe9")
ASCII_ONLY = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def run(
    folder: Path, *words: object, locale: dict[str, str] | None = None
) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "cli.main", *(str(word) for word in words)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | (locale or {})
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, check=False, timeout=300
    )


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "room.mcap"
    drive(40).write(path)
    return path


def test_text_of_any_name_is_utf8() -> None:
    assert utf8_of("é") == "é".encode()
    for odd in (f"<{LATIN}>", "<caf\ud800>"):
        assert utf8_of(odd).decode("utf-8").startswith("<caf")
    assert utf8_of(LATIN).decode() == "caf\ufffd"


def test_a_grid_is_found_by_the_name_in_its_yaml(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.zeros((3, 4), np.float32), 0.05, np.zeros(2))
    write_grid(tmp_path / "café", grid)
    assert read_grid(tmp_path / "café.yaml").log_odds.shape == (3, 4)


@pytest.mark.slow
def test_a_log_and_a_folder_in_latin_1_make_a_map_and_its_exports(
    log: Path, tmp_path: Path
) -> None:
    folder = tmp_path / LATIN
    folder.mkdir()
    shutil.copyfile(log, folder / f"{LATIN}.mcap")
    assert run(folder, "build", f"{LATIN}.mcap").returncode == 0
    (folder / "map.html").read_text("utf-8")
    for name in ("report", "grid", "trajectory", "graph", "mcap"):
        done = run(folder, "export", name, folder / "map.db")
        assert done.returncode == 0, done.stderr
    assert b"caf\xe9" in run(folder, "export", "graph", folder / "map.db").stdout


@pytest.mark.slow
def test_a_map_of_such_a_name_is_refused_where_its_grid_would_not_be_found(
    log: Path, tmp_path: Path
) -> None:
    refused = run(tmp_path, "build", log, "-o", f"{LATIN}.db")
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
    assert list(tmp_path.iterdir()) == []
    assert run(tmp_path, "build", log, "-o", f"{LATIN}.db", "--no-export").returncode == 0
    assert run(tmp_path, "export", "grid", f"{LATIN}.db").returncode == 2
    checked = run(
        tmp_path, "check", f"{LATIN}.db", "--require", "nodes >= 1", "--junit", "found.xml"
    )
    assert checked.returncode == 0
    assert "caf\ufffd.db" in (tmp_path / "found.xml").read_text("utf-8")


@pytest.mark.slow
def test_names_beyond_ascii_in_the_locale_c(log: Path, tmp_path: Path) -> None:
    shutil.copyfile(log, tmp_path / "café.mcap")
    done = run(tmp_path, "build", "café.mcap", "-o", "máp.db", locale=ASCII_ONLY)
    assert done.returncode == 0, done.stderr
    assert "image: máp.pgm" in (tmp_path / "máp.yaml").read_text("utf-8")
    again = run(tmp_path, "export", "grid", "máp.db", "--verify", locale=ASCII_ONLY)
    assert again.returncode == 0, again.stderr
    assert "café.mcap" in (tmp_path / "máp.html").read_text("utf-8")


def test_a_picture_of_maps_can_be_captioned_by_any_name() -> None:
    assert caption(LATIN) == "caf?"
