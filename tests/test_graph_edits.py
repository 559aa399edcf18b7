"""Edits: read with clear words, applied, undone, and obeyed by the solver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sample_verdicts import REJECTED

from formats.edit_files import read_edits
from mapmyworld.config import GraphConfig
from mapmyworld.errors import ConfigError, GraphError, MapError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.graph.canonical_graph import graph_from_constraints
from mapmyworld.graph.covariance import relative_pose
from mapmyworld.graph.edited import (
    changes,
    contradicted,
    contradiction,
    farthest_moved,
    strained,
)
from mapmyworld.graph.edited_constraints import (
    apply_edits,
    edits_from_json,
    edits_to_json,
    resolve_pins,
    unmet,
)
from mapmyworld.graph.solved_graph import solve
from mapmyworld.types import ConstraintKind, Judged, Poses
from mapmyworld.types.wording import reason_of
from tests.test_graph_solve import noisy_constraints, square_walk

TEXT = """
[[reject]]
from = 41
to = 1
reason = "two corridors alike"

[[add]]
from = 3
to = 43
pose = [0.0, 0.0, 0.0]
sigma = [0.05, 2.0]
reason = "tape"

[[prior]]
node = 1
pose = [5.0, 0.0, 90.0]
sigma = [0.01, 0.5]
reason = "dock"

[[pin]]
node = 20
reason = "surveyed"
"""


def edits_from(text: str, folder: Path):
    path = folder / "edits.toml"
    path.write_text(text)
    return read_edits(path)


def world():
    truth = square_walk(rounds=2)
    return truth, noisy_constraints(truth, np.random.default_rng(7))


def test_edits_are_applied_and_undone_when_the_file_no_longer_says_so(tmp_path):
    truth, constraints = world()
    edits = edits_from(TEXT, tmp_path)
    edits = resolve_pins(edits, Poses(np.arange(1, 81), truth))
    edited = apply_edits(constraints, edits)
    rejected = [c for c in edited if not c.accepted]
    assert [(c.from_id, c.to_id) for c in rejected] == [(1, 41)]
    assert "two corridors alike" in reason_of(rejected[0])
    assert [str(c.kind) for c in edited[len(constraints) :]] == ["user", "prior", "prior"]
    again = apply_edits(apply_edits(edited, edits), ())
    assert [c.verdicts for c in again] == [c.verdicts for c in constraints]


def test_edits_survive_the_store(tmp_path):
    edits = edits_from(TEXT, tmp_path)
    again = edits_from_json(edits_to_json(edits))
    assert edits_to_json(again) == edits_to_json(edits)
    assert edits_from_json(None) == ()


def test_the_solver_obeys_a_rejection_an_acceptance_and_a_prior(tmp_path):
    truth, constraints = world()
    wrong = Judged(2, 60, ConstraintKind.LOOP_CLOSURE, np.eye(4), constraints[0].information)
    ids = np.arange(1, 81)
    first = solve(ids, truth, [*constraints, wrong], planar=True)
    assert not first.constraints[-1].accepted
    text = '[[accept]]\nfrom = 2\nto = 60\nreason = "I was there"\n' + TEXT
    edited = apply_edits(first.constraints, resolve_pins(edits_from(text, tmp_path), first.poses))
    solved = solve(ids, truth, edited, planar=True)
    assert solved.constraints[len(constraints)].accepted
    assert not any(c.accepted for c in solved.constraints if (c.from_id, c.to_id) == (1, 41))
    # The prior puts the first node at x = 5, but the pin at node 20 and the false closure pull.
    assert solved.cost > 10 * first.cost
    restored = solve(ids, truth, apply_edits(solved.constraints, ()), planar=True)
    assert [c.accepted for c in restored.constraints] == [c.accepted for c in first.constraints]
    assert [c.verdicts for c in restored.constraints] == [c.verdicts for c in first.constraints]


def test_what_was_measured_to_be_false_is_so_again_when_its_acceptance_is_undone(tmp_path):
    truth, constraints = world()
    ids = np.arange(1, 81)
    doubtful = constraints[-1].judged(REJECTED)
    measured = [*constraints[:-1], doubtful]
    first = solve(ids, truth, measured, planar=True)
    ends = f"from = {doubtful.from_id}\nto = {doubtful.to_id}\n"
    edits = edits_from(f'[[accept]]\n{ends}reason = "I was there"\n', tmp_path)
    found = first
    for _ in range(2):  # by the edit, and by the next build
        found = solve(ids, truth, apply_edits(found.constraints, edits), planar=True)
        assert found.constraints[-1].accepted
    restored = solve(ids, truth, apply_edits(found.constraints, ()), planar=True)
    assert not restored.constraints[-1].accepted
    assert restored.constraints[-1].verdicts == first.constraints[-1].verdicts == (REJECTED,)


def test_an_edit_of_nothing_is_reported(tmp_path):
    _, constraints = world()
    edits = edits_from('[[reject]]\nfrom = 1\nto = 77\nreason = "no"\n', tmp_path)
    assert unmet(constraints, edits) == ["reject: no constraint between 1 and 77"]
    assert apply_edits(constraints, edits) == tuple(constraints)  # it may be found later
    with pytest.raises(GraphError, match="no node 77"):
        resolve_pins(edits, Poses(np.arange(1, 9), np.tile(np.eye(4), (8, 1, 1))))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[[burn]]\nnode = 1", "an edits file holds"),
        ('[[reject]]\nfrom = 1\nreason = "x"', "lacks to"),
        ("[[reject]]\nfrom = 1\nto = 2", "lacks reason"),
        ('[[reject]]\nfrom = 1\nto = 2\nreason = " "', "reason must say why"),
        ('[[reject]]\nfrom = 1\nto = 1\nreason = "x"', "same node"),
        ('[[reject]]\nfrom = 1\nto = 2\nkind = "x"\nreason = "x"', "kind is one of"),
        ('[[add]]\nfrom = 1\nto = 2\npose = [1]\nsigma = [1, 1]\nreason = "x"', "pose is"),
        ('[[add]]\nfrom = 1\nto = 2\npose = [1, 2, 3]\nreason = "x"', "give either sigma"),
        ('[[add]]\nfrom = 1\nto = 2\npose = [1, 2, nan]\nsigma = [1, 1]\nreason = "x"', "finite"),
        ('[[pin]]\nnode = "a"\nreason = "x"', "whole numbers"),
        ('[[pin]]\nnode = 1\nwhy = 2\nreason = "x"', "does not know why"),
        ("[[pin]", "not valid TOML"),
        ("x = " + "[" * 5000, "not valid TOML"),
        ("x = 1" + "0" * 5000, "not valid TOML"),
        ("reject = [1]", "[[reject]] number 1: is no table"),
        ('[[reject]]\nfrom = 1\nto = 2\nkind = [1]\nreason = "x"', "kind is one of"),
        ('[[pin]]\nnode = 1\npose = [1e12, 0, 0]\nreason = "x"', "out of range"),
        (f'[[pin]]\nnode = 1\npose = [{10**400}, 0, 0]\nreason = "x"', "made of numbers"),
        (
            '[[prior]]\nnode = 1\npose = [1, 2, 3]\nsigma = [1e-200, 1]\nreason = "x"',
            "at least 1e-09",
        ),
    ],
)
def test_a_broken_edits_file_is_explained(text, word, tmp_path):
    with pytest.raises((ConfigError, MapError), match=word.replace("[", r"\[")):
        edits_from(text, tmp_path)


def test_what_is_stated_and_not_met_is_reported_with_what_fights_it(tmp_path):
    """A wrong addition, sure of itself: closures that were accepted stand against it."""
    truth, constraints = world()
    ids = np.arange(1, 81)
    before = solve(ids, truth, constraints, planar=True)
    assert contradicted(before.constraints, before.poses, True) == []
    text = '[[add]]\nfrom = 5\nto = 30\npose = [0, 0, 0]\nsigma = [0.01, 0.5]\nreason = "no"\n'
    edits = edits_from(text, tmp_path)
    after = solve(ids, truth, apply_edits(before.constraints, edits), planar=True)
    (reported,) = contradicted(after.constraints, after.poses, True)
    assert (reported.constraint.from_id, reported.constraint.to_id) == (5, 30)
    first, *others = changes(before.constraints, after.constraints)
    assert (first.constraint.kind, first.what) == (ConstraintKind.USER, "accepted")
    assert all(c.what == "rejected" for c in others)
    fighting = strained((before.constraints, before.poses), (after.constraints, after.poses), True)
    assert fighting
    assert all(one.after > one.before + 1 for one in fighting)
    line = contradiction(reported, fighting)
    assert line.startswith("user 5 -> 30, stated by hand, is contradicted by the rest of the graph")
    assert "sigma, limit 3.0); it fights loop_closure " in line
    assert "it fights no single constraint" in contradiction(reported, [])
    rejected = {(c.constraint.from_id, c.constraint.to_id) for c in others}
    assert rejected <= {(s.constraint.from_id, s.constraint.to_id) for s in fighting}
    undone = solve(ids, truth, apply_edits(after.constraints, ()), planar=True)
    assert [c.what for c in changes(after.constraints, undone.constraints)][:1] == [
        "no longer found"
    ]
    assert changes(before.constraints, undone.constraints) == []


PRIOR = """
[[prior]]
node = {node}
pose = [{x}, {y}, 0.0]
sigma = [0.01, 0.5]
reason = "tape"
"""


@pytest.mark.parametrize(("off", "reported"), [(0.0, set()), (1.0, {1, 5})])
def test_priors_are_met_within_three_sigmas_or_reported_with_those_they_fight(
    tmp_path, off, reported
):
    """Along the square's first side; the second is where it was driven, or a metre from there."""
    truth, constraints = world()
    ids = np.arange(1, 81)
    text = PRIOR.format(node=1, x=0.0, y=0.0) + PRIOR.format(node=5, x=4.0 + off, y=0.0)
    solved = solve(ids, truth, apply_edits(constraints, edits_from(text, tmp_path)), planar=True)
    unmet_ones = contradicted(solved.constraints, solved.poses, True)
    assert {m.constraint.to_id for m in unmet_ones} == reported
    for one in unmet_ones:
        others = [c for c in solved.constraints if c is not one.constraint]
        without = solve(ids, truth, others, planar=True)
        fought = strained(
            (without.constraints, without.poses), (solved.constraints, solved.poses), True
        )
        first = fought[0].constraint
        assert (first.kind, {first.to_id}) == (
            ConstraintKind.PRIOR,
            reported - {one.constraint.to_id},
        )
        between_them = {(s.constraint.from_id, s.constraint.to_id) for s in fought[1:]}
        assert {(k, k + 1) for k in range(1, 5)} <= between_them


def test_two_statements_about_one_node_fight_each_other(tmp_path):
    truth, constraints = world()
    ids = np.arange(1, 81)
    text = PRIOR.format(node=5, x=4.0, y=0.0) + PRIOR.format(node=5, x=4.5, y=0.0)
    solved = solve(ids, truth, apply_edits(constraints, edits_from(text, tmp_path)), planar=True)
    one, other = contradicted(solved.constraints, solved.poses, True)
    others = [c for c in solved.constraints if c is not one.constraint]
    without = solve(ids, truth, others, planar=True)
    (fought,) = strained(
        (without.constraints, without.poses), (solved.constraints, solved.poses), True
    )
    assert fought.constraint is other.constraint


def test_a_statement_that_is_stated_anew_has_changed(tmp_path):
    """Where only the pose differs, too."""
    truth, constraints = world()
    ids = np.arange(1, 81)
    first, second = (
        solve(ids, truth, apply_edits(constraints, edits_from(text, tmp_path)), planar=True)
        for text in (PRIOR.format(node=5, x=4.0, y=0.0), PRIOR.format(node=5, x=4.5, y=0.0))
    )
    found = changes(first.constraints, second.constraints)
    assert [(c.constraint.kind, c.what) for c in found] == [
        (ConstraintKind.PRIOR, "accepted"),
        (ConstraintKind.PRIOR, "no longer found"),
    ]


def test_a_relative_pose_errs_as_its_covariance_says_and_less_with_a_true_addition(tmp_path):
    """Squared sigmas of 30 drives are 3 on average (half to twice that), before and after."""
    truth, ids = square_walk(rounds=2), np.arange(1, 81)
    text = (
        "[[add]]\nfrom = 5\nto = 30\npose = [{}, {}, {}]\nsigma = [0.005, 0.1]\nreason = 'tape'\n"
    )
    right = between(truth[4], truth[29])
    squares, sigmas = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        constraints = noisy_constraints(truth, rng)
        x, y, yaw = matrix_to_planar(right[None])[0] + rng.normal(size=3) * [
            0.005, 0.005, np.radians(0.1),
        ]  # fmt: skip
        edits = edits_from(text.format(x, y, np.degrees(yaw)), tmp_path)
        for stated in (constraints, apply_edits(constraints, edits)):
            solved = solve(ids, truth, stated, True, GraphConfig(certify=False, covariances=False))
            graph = graph_from_constraints(
                ids, solved.poses.map_from_node, solved.constraints, planar=True
            )
            pose, covariance = relative_pose(graph, 5, 30)
            miss = matrix_to_planar(between(right, pose)[None])[0]
            own = covariance[np.ix_([3, 4, 2], [3, 4, 2])]
            squares.append(miss @ np.linalg.solve(own, miss))
            sigmas.append(np.sqrt(np.diag(own)))
    before, after = np.mean(squares[::2]), np.mean(squares[1::2])
    assert 1.5 < before < 6.0
    assert 1.5 < after < 6.0
    assert (np.array(sigmas[1::2]) < [0.005, 0.005, np.radians(0.1)]).all()
    assert (np.array(sigmas[::2])[:, :2] > 0.02).all()


def test_a_true_statement_is_not_called_contradicted(tmp_path):
    truth, constraints = world()
    ids = np.arange(1, 81)
    text = '[[pin]]\nnode = 20\nreason = "surveyed"\n'
    first = solve(ids, truth, constraints, planar=True)
    edits = resolve_pins(edits_from(text, tmp_path), first.poses)
    solved = solve(ids, truth, apply_edits(first.constraints, edits), planar=True)
    assert contradicted(solved.constraints, solved.poses, True) == []
    assert farthest_moved(first.poses, solved.poses)[1] < 0.01
