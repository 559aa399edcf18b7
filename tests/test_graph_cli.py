"""The commands of the back end, as a user runs them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from sample_verdicts import REJECTED

from cli.inspect_graph import _row, _uncertainty_line, facts_of_map
from cli.main import group
from cli.optimise import optimise
from formats.database import MemoryMap, open_store
from formats.graph_reading import read_graph
from formats.report.map_pictures import write_graph_picture
from mapmyworld.errors import MapError
from mapmyworld.graph.solved_graph import SolvedGraph, solve
from mapmyworld.types import ConstraintKind, Judged, Node, NodeData, Poses
from tests.test_graph_solve import false_closures, noisy_constraints, square_walk

SQUARE = """\
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 100
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 100
EDGE_SE2 2 3 1 0 1.5707963 100 0 0 100 0 100
EDGE_SE2 3 0 1.1 0 1.5707963 100 0 0 100 0 100
"""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where `optimise` writes what is given no name."""
    monkeypatch.chdir(tmp_path)


def run(path: Path, *options: str):
    return CliRunner().invoke(optimise, [str(path), *options], catch_exceptions=False)


def facts_of(solved: SolvedGraph, start: np.ndarray, worst: int = 5, poses: Poses | None = None):
    """What `inspect graph` shows of the solved graph as a planar map."""
    store = MemoryMap()
    store.put("plan", {"planar": True})
    for number, pose in enumerate(start, 1):
        store.add_node(Node(number, 0, number, pose, pose), NodeData())
    store.add_constraints(solved.constraints)
    return facts_of_map(store, poses or solved.poses, None, worst)


def test_a_sound_graph_is_solved_written_and_drawn(tmp_path):
    path, picture = tmp_path / "square.g2o", tmp_path / "square.png"
    path.write_text(SQUARE)
    result = run(path, "--format", "json", "--image", str(picture))
    assert result.exit_code == 0
    facts = json.loads(result.stdout)
    assert (facts["nodes"], facts["edges"], facts["components"]) == (4, 4, 1)
    assert 0 < facts["cost"] < 0.5
    solved = read_graph(tmp_path / "square_optimised.g2o").graph
    assert np.allclose(solved.map_from_node[2, :2], [1, 1], atol=0.1)
    assert cv2.imread(str(picture)) is not None


def test_what_is_given_no_name_goes_into_the_current_folder(tmp_path):
    """A folder of data may not be the user's, or be read-only."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "square.g2o").write_text(SQUARE)
    assert run(Path("data/square.g2o")).exit_code == 0
    assert [file.name for file in (tmp_path / "data").iterdir()] == ["square.g2o"]
    assert (tmp_path / "square_optimised.g2o").exists()


def test_what_is_sound_of_a_broken_graph_is_solved_with_exit_code_3(tmp_path):
    path = tmp_path / "broken.g2o"
    path.write_text(SQUARE + "EDGE_SE2 0 2 nan 0 0 1 0 0 1 0 1\nEDGE_SE2 8 9 1 0 0 1 0 0 1 0 1\n")
    result = run(path, "--format", "json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["components"] == 2
    assert "line 5" in result.stderr


def test_the_number_of_threads_changes_no_byte(tmp_path):
    """A grid of streets with closures, large enough for dense fronts, in two fresh processes."""
    rng = np.random.default_rng(0)
    side, lines = 20, []
    for k in range(side * side - 1):
        for other, east in ((k + 1, (k + 1) % side), (k + side, False)):
            if other < side * side and (east or other == k + side):
                x, y = (1.0, 0.0) if east else (0.0, 1.0)
                dx, dy, turn = rng.normal(size=3) * 0.02
                lines.append(f"EDGE_SE2 {k} {other} {x + dx} {y + dy} {turn} 900 0 0 900 0 900")
    source = tmp_path / "grid.g2o"
    source.write_text("\n".join(lines))
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    written = []
    for threads in ("1", "2"):
        target = tmp_path / f"{threads}.g2o"
        command = [sys.executable, "-m", "cli.main", "optimise", str(source), "-o", str(target)]
        environment = os.environ | dict.fromkeys(names, threads)
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=300)
        written.append(target.read_bytes())
    assert written[0] == written[1]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MapError, match=r"nothing\.g2o"):
        run(tmp_path / "nothing.g2o")


def test_the_audit_counts_and_explains():
    rng = np.random.default_rng(1)
    truth = square_walk()
    constraints = noisy_constraints(truth, rng) + false_closures(len(truth), 10, rng)
    ids = np.arange(1, len(truth) + 1)
    drifted = truth.copy()
    drifted[:, 0, 3] += np.linspace(0, 2, len(truth))
    solved = solve(ids, drifted, constraints, planar=True)
    facts = facts_of(solved, drifted)
    assert facts["constraints"]["loop_closure"]["rejected"] == 10
    assert len(facts["rejected"]) == 10
    assert facts["components"] == [{"first": 1, "last": 120, "nodes": 120}]
    assert facts["overconfident"] == []
    # Noise was drawn from the stated covariances.
    assert facts["overconfidence"]["neighbour"] == pytest.approx(1.0, abs=0.15)
    assert facts["overconfidence"]["loop_closure"] == pytest.approx(1.0, abs=0.25)
    # Nodes a round of 40 steps apart had drifted by 2 m / 3.
    assert facts["corrections"][0]["start_metres"] == pytest.approx(2 * 40 / 119, abs=0.1)
    assert facts["uncertainty"]["largest_metres"] > facts["uncertainty"]["median_metres"]


def test_what_certainty_is_relative_to_is_said_and_a_prior_is_named_by_its_node():
    truth = square_walk()
    ids = np.arange(1, len(truth) + 1)
    measured = noisy_constraints(truth, np.random.default_rng(1))
    dock = Judged(30, 30, ConstraintKind.PRIOR, truth[29], 1e4 * np.eye(6))
    for constraints, frame in ((measured, "the first node"), ([*measured, dock], "the map")):
        solved = solve(ids, truth, constraints, planar=True)
        first = solved.poses.covariances[0]
        assert (np.trace(first) > 1e-6) == (frame == "the map")
        facts = facts_of(solved, truth, 1000)
        assert _uncertainty_line(facts).endswith(f" deg, relative to {frame}")
    (row,) = [row for row in facts["worst"] if row["kind"] == "prior"]
    assert _row(row, "reject").startswith("  prior on node 30  0.0")


def test_constraints_that_claim_too_much_are_named():
    """Odometry whose sigmas are stated four times too small, and the sound one beside it."""
    rng = np.random.default_rng(4)
    truth = square_walk()
    sound = noisy_constraints(truth, rng)
    kind = ConstraintKind.NEIGHBOUR
    bold = [replace(c, information=16.0 * c.information) if c.kind == kind else c for c in sound]
    ids = np.arange(1, len(truth) + 1)
    for constraints, named in ((sound, []), (bold, ["neighbour"])):
        solved = solve(ids, truth, constraints, planar=True)
        facts = facts_of(solved, truth)
        assert facts["overconfident"] == named


def test_poses_that_know_more_than_the_constraints_do_not_make_these_dishonest():
    """Aligned scans lie at the truth, and miss the whole error of each motion between closures."""
    truth = square_walk()
    ids = np.arange(1, len(truth) + 1)
    constraints = noisy_constraints(truth, np.random.default_rng(1))
    motions = [c for c in constraints if c.kind == ConstraintKind.NEIGHBOUR]
    few = [c for c in constraints if c.kind != ConstraintKind.NEIGHBOUR][::8]
    solved = solve(ids, truth, [*motions, *few], planar=True)
    aligned = replace(solved.poses, map_from_node=truth)
    own, beside = (
        facts_of(solved, truth, poses=poses)["overconfidence"] for poses in (solved.poses, aligned)
    )
    assert beside == pytest.approx(own, rel=0.01)
    assert 0.7 < own["neighbour"] < 1.5


def test_the_picture_shows_the_path_in_blue_at_equal_scales(tmp_path):
    rng = np.random.default_rng(1)
    truth = square_walk(rounds=2)
    solved = solve(np.arange(1, 81), truth, noisy_constraints(truth, rng), planar=True)
    write_graph_picture(tmp_path / "a.png", solved.poses, solved.constraints)
    blue, green, red = np.moveaxis(cv2.imread(str(tmp_path / "a.png")).astype(int), -1, 0)
    rows, columns = np.nonzero((blue > red + 100) & (blue > green + 50))
    assert len(rows) > 2000
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), rel=0.3)  # the legend's line included


def test_rejected_closures_are_dotted_and_grey(tmp_path):
    truth = square_walk(rounds=2)
    ids, closure = np.arange(1, 81), ConstraintKind.LOOP_CLOSURE
    red, grey = {}, {}
    for accepted in (True, False):
        verdicts = () if accepted else (REJECTED,)
        made = Judged(1, 21, closure, np.eye(4), np.eye(6), verdicts=verdicts)
        write_graph_picture(tmp_path / "a.png", Poses(ids, truth), [made])
        blue, _, found = np.moveaxis(cv2.imread(str(tmp_path / "a.png")).astype(int), -1, 0)
        red[accepted] = (found > blue + 100).sum()
        grey[accepted] = ((found > 100) & (found < 200)).sum()
    assert red[True] > red[False] + 100  # and the axes of the start
    assert grey[False] > 0


def test_a_solved_graph_is_written_as_a_map_and_read_again(tmp_path):
    path, made = tmp_path / "square.g2o", tmp_path / "square.db"
    path.write_text(SQUARE)
    first = json.loads(run(path, "--format", "json", "-o", str(made)).stdout)
    again = json.loads(run(made, "--format", "json", "-o", str(tmp_path / "b.g2o")).stdout)
    assert (again["nodes"], again["edges"]) == (first["nodes"], first["edges"])
    assert again["cost"] == pytest.approx(first["cost"], rel=1e-6)
    with open_store(made, read_only=True) as store:
        poses = store.poses()
    assert poses is not None
    assert poses.covariances is not None
    assert np.trace(poses.covariances[2]) > 0


def test_a_graph_that_falls_apart_makes_a_map_that_does_not_pass_as_whole(tmp_path):
    path, made = tmp_path / "parts.g2o", tmp_path / "parts.db"
    apart = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 900 0 0 900 0 900\n" for k in (0, 1, 10, 11))
    path.write_text(apart)
    done = run(path, "-o", str(made))
    assert done.exit_code == 3
    assert "2 components" in done.stderr
    checked = CliRunner().invoke(group, ["check", str(made), "--require", "nodes >= 6"])
    assert checked.exit_code == 4
    assert "2 components" in checked.output


def test_a_map_that_fails_on_the_way_leaves_the_one_before(tmp_path, monkeypatch):
    path, made = tmp_path / "square.g2o", tmp_path / "square.db"
    path.write_text(SQUARE)
    assert run(path, "-o", str(made)).exit_code == 0
    before = made.read_bytes()

    def fail(*_):
        raise MapError("no room")

    monkeypatch.setattr("cli.optimise_map.constraints_of", fail)
    with pytest.raises(MapError, match="no room"):
        run(path, "-o", str(made))
    assert made.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == [made, path]
