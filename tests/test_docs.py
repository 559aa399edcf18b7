"""The pages about the program say what the program says."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from functools import reduce
from pathlib import Path

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


# Of rosbags, mcap and Nav2; and an action as GitHub names it.
_OF_OTHERS = {"rosbag1/reader.py", "reader.py", "bringup_launch.py", "mapmyworld/mapmyworld"}
_PATHS = r"(?:mapmyworld|formats|cli|docs|tests|benchmarks|sample_logs)/[\w/.-]*\w"
_NAMED = re.compile(rf"(?<![\w/.-])({_PATHS}|[\w/-]*\w\.py\b)(?![\w/*<(])")


def _pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_files_named_in_the_pages_exist() -> None:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    known = {path[at:] for path in listed for at in _beginnings(path)}
    known |= {str(Path(path).parents[k]) for path in listed for k in range(path.count("/"))}
    missing = [
        f"{page.name} names {name}"
        for page in _pages()
        for name in set(_NAMED.findall(page.read_text("utf-8"))) - known - _OF_OTHERS
    ]
    assert missing == []


def _beginnings(path: str) -> list[int]:
    """Where a name of it that leaves packages out may begin."""
    return [0, *(found.end() for found in re.finditer("/", path))]


def test_names_of_modules_and_functions_in_the_pages_exist() -> None:
    for page in _pages():
        for name in set(
            re.findall(r"`((?:mapmyworld|formats)(?:\.\w+)+)", page.read_text("utf-8"))
        ):
            assert _is_a_name(name), f"{page.name} names {name}"


def _is_a_name(dotted: str) -> bool:
    words = dotted.split(".")
    for count in range(len(words), 0, -1):
        try:
            module = importlib.import_module(".".join(words[:count]))
            reduce(getattr, words[count:], module)
        except (ImportError, AttributeError):
            continue
        return True
    return False
