"""The pages about the program say what the program says."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from conftest import ROOT

from cli.main import COMMANDS


@pytest.mark.parametrize(
    "name", ["commands.md", "settings.md", "troubleshooting.md", "messages.md"]
)
def test_generated_pages_are_up_to_date(name: str) -> None:
    """When this fails: `python docs/generate.py`.

    In a process of its own: commands remember how they were called by other tests.
    """
    code = f"import runpy; print(runpy.run_path('docs/generate.py')['PAGES']['{name}'](), end='')"
    command = [sys.executable, "-c", code]
    page = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=ROOT, timeout=300
    ).stdout
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == page


def test_every_message_has_a_suggestion() -> None:
    """The table is made of these rows; a message that the table lacks fails the test above."""
    sys.path.insert(0, str(ROOT / "docs"))
    from all_messages import SUGGESTIONS, gathered

    rows = gathered()
    assert len(rows) > 300
    assert {row.text for row in rows if len(row.suggestion) < 10} == set()
    used = {room for room in SUGGESTIONS for row in rows if row.file.startswith(room)}
    assert used == set(SUGGESTIONS)  # none of a room that is gone


def test_commands_named_in_the_readme_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^mapmyworld (\w+)", text, re.MULTILINE))
    assert named
    assert named <= set(COMMANDS)


def test_the_readme_shows_a_map_and_a_report_before_anything_else() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text.partition("\n## ")[0])
    assert len(shown) == 2
    for name in shown:
        assert (ROOT / name).read_bytes().startswith(b"\x89PNG")
        assert (ROOT / name).stat().st_size < 200_000
        assert name.rpartition("/")[2] in (ROOT / "benchmarks" / "report_pictures.py").read_text(
            "utf-8"
        )


def test_the_readme_says_what_is_not_supported_and_how_each_installs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    table = text.partition("## What is supported, and what is not")[2].partition("\n## ")[0]
    rows = {row.split(" | ")[0].strip("| "): row.split(" | ") for row in table.splitlines()[2:]}
    for name in ("sensors", "worlds", "containers", "platforms", "sizes"):
        assert len(rows[name]) == 4
        assert all(len(cell) > 10 for cell in rows[name][1:])
    assert "pipx install ." in text
    assert "make install" in text


def test_links_between_pages_lead_somewhere() -> None:
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for link in re.findall(r"\]\((?!http)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name} links to {link}"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_shows_an_example(name: str) -> None:
    from click.testing import CliRunner

    from cli.main import group

    help_text = CliRunner().invoke(group, [name, "--help"]).output
    assert "mapmyworld " + name in help_text.split("Usage:")[1].split("\n", 1)[1] or name in {
        "doctor"
    }
