"""`mapmyworld edit` and later builds: a map follows from its log and its edits alone."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from room_drive import write

from cli.main import group
from formats.database import open_store
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.types import CLOSURES, ConstraintKind, Judged
from mapmyworld.types.wording import reason_of


def run(*arguments: object, code: int = 0) -> None:
    found = CliRunner().invoke(group, [str(a) for a in arguments])
    assert found.exit_code == code, found.output + repr(found.exception)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log and map of two laps of the apartment."""
    settings = SimulationSettings()
    laser = replace(settings.laser, beams=181, rate=4.0)
    camera = replace(settings.camera, enabled=False)
    drive = simulate("apartment", laps=2, settings=replace(settings, laser=laser, camera=camera))
    log = tmp_path_factory.mktemp("edits") / "flat.mcap"
    write(log, drive.messages())
    run("build", log, "-o", log.with_suffix(".db"), "-q", "--no-export")
    return log


@pytest.fixture
def flat(built: Path, tmp_path: Path) -> Path:
    """A map of its own for every test, its log beside it."""
    for kept in (built, built.with_suffix(".db")):
        shutil.copy(kept, tmp_path)
    return tmp_path / "flat.db"


def state(path: Path) -> tuple[list[Any], bytes, bytes]:
    """Constraints with their verdicts, poses and the grid."""
    with open_store(path, read_only=True) as store:
        reported = [
            (c.from_id, c.to_id, c.kind, c.accepted, reason_of(c)) for c in store.constraints()
        ]
        poses, grid = store.poses(), store.grid()
        assert poses is not None
        assert grid is not None
        return reported, poses.map_from_node.tobytes(), grid.log_odds.tobytes()


def closures(path: Path) -> list[Judged]:
    with open_store(path, read_only=True) as store:
        return [c for c in store.constraints() if c.kind in CLOSURES and c.accepted]


@pytest.mark.slow
def test_what_a_build_found_last_can_be_rejected_and_stays_so(flat: Path) -> None:
    """The optimiser's own search finds it; a build that begins there knows nothing of it yet."""
    found = [c for c in closures(flat) if c.kind == ConstraintKind.PROXIMITY]
    assert found
    edits = flat.with_name("edits.toml")
    edits.write_text(
        "".join(
            f'[[reject]]\nfrom = {c.from_id}\nto = {c.to_id}\nreason = "not so"\n' for c in found
        )
    )
    run("edit", flat, edits, "-q")
    edited = state(flat)
    ends = {(c.from_id, c.to_id) for c in found}
    assert not ends & {(c.from_id, c.to_id) for c in closures(flat)}
    run("build", flat.with_suffix(".mcap"), "-o", flat, "-q", "--no-export")
    assert state(flat) == edited


@pytest.mark.slow
def test_edits_that_are_taken_back_leave_no_trace(flat: Path) -> None:
    before, edits = state(flat), flat.with_name("edits.toml")
    edits.write_text(
        "[[add]]\nfrom = 1\nto = 9\npose = [0.0, 0.0, 40.0]\nsigma = [0.02, 1.0]\n"
        'reason = "wrong on purpose"\n'
    )
    run("edit", flat, edits, "-q", code=3)
    assert state(flat) != before
    edits.write_text("")
    run("edit", flat, edits, "-q")
    assert state(flat) == before


PIN = '[[pin]]\nnode = 1\npose = [100.0, 50.0, 0.0]\nreason = "surveyed"\n'


@pytest.mark.slow
def test_what_a_build_wrote_beside_its_map_shows_the_edited_one(flat: Path) -> None:
    """A robot would else load the grid of before."""
    edits, path = flat.with_name("edits.toml"), flat.with_suffix(".tum")
    edits.write_text(PIN)
    run("edit", flat, edits, "-q")
    assert not path.exists()  # nothing was beside it
    run("edit", flat, edits, "-q", "--no-export")
    run("build", flat.with_suffix(".mcap"), "-o", flat, "-q")
    pinned = {e: flat.with_suffix(e).read_bytes() for e in (".pgm", ".yaml", ".tum")}
    edits.write_text("")
    run("edit", flat, edits, "-q", "--no-export")
    assert path.read_bytes() == pinned[".tum"]
    run("edit", flat, edits, "-q")
    assert path.read_text().split()[1:3] == ["0.000000000", "0.000000000"]
    assert b"origin: [9" not in flat.with_suffix(".yaml").read_bytes()
    edits.write_text(PIN)
    run("edit", flat, edits, "-q")
    assert {e: flat.with_suffix(e).read_bytes() for e in pinned} == pinned


def placed(path: Path, node: int) -> np.ndarray:
    """(x, y, yaw) of a node."""
    with open_store(path, read_only=True) as store:
        poses = store.poses()
    assert poses is not None
    return matrix_to_planar(poses.map_from_node[poses.ids == node])[0]


def test_priors_hold_the_final_poses(flat: Path, tmp_path: Path) -> None:
    """Beside all scans, which are aligned with each other: the map moves, and gives way a little.

    Node 100 is put 15 mm from where the scans have it, to a millimetre; node 1 may give a
    centimetre.
    """
    motion = np.array([2.0, 1.0, np.radians(70.0)])
    wanted = [compose_planar(motion, placed(flat, node)) for node in (1, 100)]
    wanted[1][0] += 0.015
    sigmas = (np.array([0.01, 0.01, np.radians(0.5)]), np.array([0.001, 0.001, np.radians(0.5)]))
    rows = [
        f"[[prior]]\nnode = {node}\npose = [{x:.12g}, {y:.12g}, {np.degrees(yaw):.12g}]\n"
        f'sigma = [{sigma[0]}, 0.5]\nreason = "surveyed"\n'
        for node, (x, y, yaw), sigma in zip((1, 100), wanted, sigmas, strict=True)
    ]
    (tmp_path / "edits.toml").write_text("\n".join(rows), encoding="utf-8")
    run("edit", flat, tmp_path / "edits.toml", "-q", "--no-export")
    for node, pose, sigma in zip((1, 100), wanted, sigmas, strict=True):
        missed = between_planar(pose, placed(flat, node))
        assert (np.abs(missed) < 3.0 * sigma).all(), node
