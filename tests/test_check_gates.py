"""`check`: what is required, by how much it is missed, and where the verdicts are written."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from database_samples import fill
from hypothesis import given
from hypothesis import strategies as st

from cli.checking import BETTER
from cli.figure_names import figures_of, flattened
from cli.gates import judged, no_worse, read_requirements
from cli.main import group
from formats.check_results import Verdict, junit_xml, markdown
from formats.database import open_store
from mapmyworld.errors import ConfigError
from mapmyworld.types import ConstraintKind


@pytest.fixture
def small(tmp_path: Path) -> Path:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    return tmp_path / "map.db"


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(group, [*map(str, words)])


def test_every_number_that_inspect_prints_can_be_required(small: Path) -> None:
    for part in ("map", "graph"):
        shown = json.loads(run("inspect", part, small, "--format", "json").stdout)
        with open_store(small, read_only=True) as store:
            figures = figures_of(store)
        for name, value in flattened({part: shown}).items():
            if name.endswith("rejected.count"):
                continue  # printed in part, counted in full
            assert figures[name] == value
            result = run("check", small, "--allow-partial", "--require", f"{name} == {value!r}")
            assert result.exit_code == 0, result.output


def test_residuals_are_judged_by_the_covariances_that_inspect_prints(small: Path) -> None:
    """Scaled by the variance factors of the solution: 4 for all kinds halves what was stated."""
    name = "graph.overconfidence.neighbour"
    with open_store(small) as store:
        stated = figures_of(store)[name]
        store.put("solve", {"variance_factors": dict.fromkeys(ConstraintKind, 4.0)})
        assert figures_of(store)[name] == pytest.approx(stated / 2.0)
    shown = json.loads(run("inspect", "graph", small, "--format", "json").stdout)
    printed = shown["overconfidence"]["neighbour"]
    assert printed == pytest.approx(stated / 2.0)
    result = run("check", small, "--allow-partial", "--require", f"{name} == {printed!r}")
    assert result.exit_code == 0, result.output


def test_a_failing_gate_says_by_how_much(small: Path) -> None:
    result = run("check", small, "--allow-partial", "--require", "nodes >= 10")
    assert result.exit_code == 4
    assert "is 3, nodes of the graph; misses 10 by 7" in result.output


def test_a_partial_map_never_passes_as_whole(small: Path) -> None:
    with open_store(small) as store:
        store.put("track", {"losses": ["the last 3 s of the log cannot be read"]})
    result = run("check", small, "--require", "nodes >= 1")
    assert result.exit_code == 4
    assert "partial: the last 3 s of the log cannot be read" in result.output
    assert run("check", small, "--allow-partial", "--require", "nodes >= 1").exit_code == 0


def test_a_misspelt_figure_is_named_with_its_neighbour(small: Path) -> None:
    result = run("check", small, "--require", "graph.components.cont == 1")
    assert isinstance(result.exception, ConfigError)
    assert "did you mean graph.components.count?" in str(result.exception)


def test_a_map_is_no_worse_than_itself(small: Path) -> None:
    result = run("check", small, "--allow-partial", "--baseline", small, "--tolerance", "0")
    assert result.exit_code == 0, result.output
    assert "free_area" in result.output


def test_verdicts_are_written_for_machines_and_for_people(small: Path, tmp_path: Path) -> None:
    junit, comment = tmp_path / "out.xml", tmp_path / "out.md"
    wanted = ["--require", "nodes >= 10", "--require", "nodes < 5"]
    run("check", small, "--allow-partial", *wanted, "--junit", junit, "--markdown", comment)
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert "misses 10 by 7" in str(suite.find("testcase/failure").get("message"))  # type: ignore[union-attr]
    lines = comment.read_text().splitlines()
    assert lines[0] == "### map.db: 1 of 2 do not hold"
    assert sum(line.startswith("| ❌") for line in lines) == 1
    assert "`nodes < 5`" in lines[-1]  # in a code span, an entity would be shown as it is written


@given(st.text(), st.text(), st.booleans())
def test_no_text_breaks_the_files(name: str, message: str, passed: bool) -> None:
    verdicts = [Verdict(name, name, 1.0, passed, message)]
    suite = ElementTree.fromstring(junit_xml("map", verdicts).encode("utf-8", "replace"))
    assert suite.get("failures") == str(int(not passed))
    assert len(markdown("map", verdicts).splitlines()) >= 5
    assert not any("\n" in row for row in markdown("map", verdicts).split("\n"))


@given(st.floats(0.1, 1e6), st.floats(-0.5, 0.5), st.sampled_from(sorted(BETTER)))
def test_worse_is_worse_in_each_figures_own_direction(old: float, change: float, key: str) -> None:
    """A figure passes where it moved for the better, or for the worse within the tolerance."""
    (verdict,) = no_worse({key: old * (1 + change)}, {key: old}, 0.1)
    loss = -change if BETTER[key] > 0 else change
    if abs(loss - 0.1) > 1e-6:
        assert verdict.passed is (loss < 0.1)


@pytest.mark.parametrize("symbol", [">=", "<=", "==", "!=", ">", "<"])
def test_requirements_read_as_they_are_written(symbol: str) -> None:
    (requirement,) = read_requirements([f"graph.nodes{symbol} 2"])
    assert judged(requirement, 2.0).passed is (symbol in {">=", "<=", "=="})
    assert str(requirement) == f"graph.nodes {symbol} 2"
