"""What users' CI runs of ours: the action's own shell, the example workflow, the image's recipe."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from conftest import ROOT
from ruamel.yaml import YAML

STEPS = ("Build", "Check")


def loaded(path: str) -> Any:
    return YAML(typ="safe").load((ROOT / path).read_text(encoding="utf-8"))


def filled(text: str, inputs: dict[str, str]) -> str:
    """`${{ inputs.name }}` as the runner replaces it."""
    return re.sub(r"\$\{\{ *inputs\.(\w+) *\}\}", lambda m: inputs[m[1]], text)


def run_action(inputs: dict[str, str], folder: Path) -> tuple[int, str]:
    """The action's Build and Check as a runner would run them: bash -e, in the given folder."""
    action = loaded("action.yml")
    values = {name: str(spec.get("default", "")) for name, spec in action["inputs"].items()}
    values |= inputs
    reported = ""
    bin_folder = str(Path(sys.executable).parent)
    for step in action["runs"]["steps"]:
        if step.get("name") not in STEPS:
            continue
        environment = {name: filled(text, values) for name, text in step["env"].items()}
        environment |= {
            "PATH": f"{bin_folder}:{os.environ['PATH']}",
            "HOME": os.environ.get("HOME", "/"),
            "GITHUB_STEP_SUMMARY": str(folder / "summary.md"),
        }
        command = ["bash", "-eo", "pipefail", "-c", filled(step["run"], values)]
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=folder,
            env=environment,
            check=False,
            timeout=300,
        )
        reported += done.stdout + done.stderr
        if done.returncode:
            return done.returncode, reported
    return 0, reported


def test_every_input_of_the_example_is_one_of_the_action() -> None:
    workflow, action = loaded("docs/examples/map-check.yml"), loaded("action.yml")
    (job,) = workflow["jobs"].values()
    used = [step for step in job["steps"] if "mapmyworld" in step["uses"]]
    assert used
    for step in used:
        assert set(step["with"]) <= set(action["inputs"])


@pytest.mark.slow
def test_the_example_workflow_passes_and_a_harder_one_fails(tmp_path: Path) -> None:
    (job,) = loaded("docs/examples/map-check.yml")["jobs"].values()
    (step,) = (step for step in job["steps"] if "mapmyworld" in step["uses"])
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    status, reported = run_action(step["with"], tmp_path)
    assert status == 0, reported
    assert (tmp_path / "map" / "map.html").is_file()
    suite = ElementTree.parse(tmp_path / "map" / "check.xml").getroot()
    assert suite.get("failures") == "0"
    assert "all requirements hold" in (tmp_path / "summary.md").read_text()
    # The map is there already, so only the check is done anew.
    status, reported = run_action(step["with"] | {"require": "nodes >= 100000"}, tmp_path)
    assert status == 4, reported
    assert "misses 100000 by" in (tmp_path / "summary.md").read_text()


def test_the_image_is_slim_and_its_user_is_nobody_special() -> None:
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    stages = [line for line in lines if line.startswith("FROM")]
    assert len(stages) == 2
    assert all("-slim" in line for line in stages)
    last = lines[lines.index(stages[-1]) :]
    assert [line for line in last if line.startswith("USER")] == ["USER 1000"]
    assert any("useradd" in line and "--uid 1000" in line for line in last)
    assert last.index("USER 1000") < last.index('ENTRYPOINT ["mapmyworld"]')
    copied = {line.split()[1] for line in lines if line.startswith("COPY") and "--from" not in line}
    assert {"mapmyworld", "cli", "formats", "pyproject.toml"} <= copied
    allowed = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {f"!{name}" for name in copied} <= set(allowed)


def test_ci_runs_the_users_command_before_it_installs_anything() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    first, _, then = script.partition("\nmake test\n")
    assert then
    assert "install" not in first
    assert "-m beyond_pip" in then
    (job,) = loaded(".github/workflows/test.yml")["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["bash .ci/run"]


def test_property_tests_draw_new_examples_in_ci_too_and_say_how_to_replay_them() -> None:
    """Hypothesis itself would draw the same ones each time where CI is set."""
    code = "import conftest as c; s = c.settings(); print(s.derandomize, s.print_blob, s.deadline)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command,
        cwd=ROOT / "tests",
        env=os.environ | {"CI": "true"},
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert done.stdout.split() == ["False", "True", "None"]
    assert "--hypothesis-seed=$(SEED)" in (ROOT / "Makefile").read_text(encoding="utf-8")
