"""What `edit` reports about what it did, and `inspect graph --between` of how a node is turned."""

from __future__ import annotations

import html
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from sample_maps import apartment  # noqa: F401

from cli.main import group

WRONG = """[[add]]
from = 3
to = 150
pose = [4.2, 0.0, 90.0]
sigma = [0.05, 2.0]
reason = "wrong on purpose"
"""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(group, [str(a) for a in arguments], catch_exceptions=False)


def test_an_edit_is_accounted_for_constraint_by_constraint(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, edits = tmp_path / "map.db", tmp_path / "edits.toml"
    for kept in (path, path.with_suffix(".html")):
        shutil.copy(apartment.with_suffix(kept.suffix), kept)
    edits.write_text(WRONG)
    result = run("edit", path, edits, "-q")
    assert result.exit_code == 3
    assert "1 edits applied: " in result.stdout
    assert "  accepted: user 3 -> 150  by hand: add: wrong on purpose" in result.stdout
    lost = result.stdout.count("  rejected: loop_closure ")
    assert lost >= 4
    assert (
        "user 3 -> 150, stated by hand, is contradicted by the rest of the graph" in result.stderr
    )
    assert " constraints contradict the edits; the largest residuals:" in result.stderr
    assert result.stderr.count("sigma, rejected") >= 4
    (line,) = (x for x in result.stderr.splitlines() if x.startswith("mapmyworld: user 3 -> 150"))
    told = line.removeprefix("mapmyworld: ")
    assert "; it fights loop_closure " in told
    assert f"problem     {told}" in run("inspect", "graph", path).stdout
    facts = json.loads(run("inspect", "graph", path, "--format", "json").stdout)
    stated, apart = facts["problems"]
    assert stated == told
    assert apart.startswith("the map contradicts itself: ")
    assert html.escape(told) in path.with_suffix(".html").read_text()
    edits.write_text("")
    monkeypatch.chdir(tmp_path)
    undone = run("edit", "edits.toml", "-q")  # of map.db
    assert undone.exit_code == 0
    assert "  no longer found: user 3 -> 150" in undone.stdout
    assert undone.stdout.count("  accepted: loop_closure ") == lost
    assert undone.stderr == ""


@pytest.mark.slow
def test_many_wrong_statements_fight_what_fits_without_any_of_them(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No poses meet both. Without either alone the other has the closures rejected all the same."""
    monkeypatch.setattr("mapmyworld.stages.solve_and_judge._ALONE", 1)
    path, edits = tmp_path / "map.db", tmp_path / "edits.toml"
    shutil.copy(apartment, path)
    edits.write_text(WRONG + WRONG.replace("90.0", "-90.0"))
    result = run("edit", path, edits, "-q", "--no-export")
    assert result.exit_code == 3
    lines = [x for x in result.stderr.splitlines() if x.startswith("mapmyworld: user 3 -> 150")]
    assert len(lines) == 2
    assert all("; it fights loop_closure " in line for line in lines)


@pytest.mark.parametrize("ends", [("1", "100"), ("100", "1")])
def test_a_turn_between_nodes_has_its_sign(
    apartment: Path,  # noqa: F811
    ends: tuple[str, str],
) -> None:
    words = ["inspect", "graph", apartment, "--between", *ends]
    facts = json.loads(run(*words, "--format", "json").stdout)["between"]
    yaw = facts["roll_pitch_yaw"][2]
    assert facts["degrees"] == pytest.approx(abs(yaw))
    place = " ".join(f"{value:+.3f}" for value in facts["xyz"])
    sigmas = " ".join(f"{value:.3g}" for value in facts["sigmas_xyz"])
    shown = run(*words).stdout
    assert f"{place} m, turned {yaw:+.2f} deg; one sigma {sigmas} m, " in shown
    assert np.hypot(*facts["sigmas_xyz"][:2]) == pytest.approx(facts["sigma_metres"])


def test_a_turn_out_of_the_plane_has_three_signs() -> None:
    from cli.inspect_graph import _turn

    assert _turn((0.001, 0.0, -12.5)) == "-12.50 deg"
    assert _turn((1.0, -2.0, -12.5)) == "+1.00 -2.00 -12.50 deg (roll, pitch, yaw)"
