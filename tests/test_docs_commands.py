"""Every command that the pages show is one that the program knows, and does what they say."""

from __future__ import annotations

import bz2
import re
import shlex
from pathlib import Path

import click
import numpy as np
import pytest
from conftest import ROOT
from docs_commands import every_line, pages, run, shown_in

from cli.main import COMMANDS, group
from mapmyworld.config.settings import list_settings


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages speak of."""
    folder = tmp_path_factory.mktemp("desk")
    logs = ROOT / "sample_logs"
    (folder / "sample_logs").symlink_to(logs)
    (folder / "log.mcap").symlink_to(logs / "apartment.mcap")
    words = ["convert", str(logs / "hall.bag"), "-o", str(folder / "drive.bag"), "--duration", "15"]
    assert run(shlex.join(["mapmyworld", *words]))[0] == 0
    (folder / "drive.clf.bz2").write_bytes(bz2.compress(carmen().encode()))
    return folder


def carmen() -> str:
    """Two seconds of a robot that stands in a round room."""
    ranges = " ".join(["3.00"] * 180)
    lines = [f"FLASER 180 {ranges} 0 0 0 0 0 0 {k / 10:.6f} host {k / 10:.6f}" for k in range(20)]
    return "\n".join(lines) + "\n"


def test_every_command_line_is_one_that_can_be_given() -> None:
    """Commands and options exist, also in pages whose commands are not run here."""
    seen = 0
    for page, words in every_line():
        command: click.Command = group
        while words and isinstance(command, click.Group):
            context = click.Context(command)
            inner = command.get_command(context, words[0])
            assert inner is not None, f"{page}: mapmyworld {' '.join(words)}"
            command, words = inner, words[1:]
        known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)}
        known |= {"--help", "-h", "--version"}
        for word in words:
            option = word.split("=")[0]
            if re.fullmatch(r"--[a-z][a-z-]*|-[a-z]", option):
                assert option in known, f"{page}: {command.name} has no {option}"
        seen += 1
    assert seen > 30


def test_every_setting_that_a_page_names_exists() -> None:
    known = {setting.name for setting in list_settings()}
    sections = {name.split(".")[0] for name in known if "." in name}
    files = r"(?!py\b|md\b|json\b|html\b)"
    pattern = re.compile(rf"`((?:{'|'.join(sections)})\.{files}[a-z_]+)(?:=[^`]*)?`")
    named = {
        (page.name, name)
        for page in pages()
        for name in pattern.findall(page.read_text(encoding="utf-8"))
        if "benchmarks" not in page.parts
    }
    assert len(named) > 60
    assert {(page, name) for page, name in named if name not in known} == set()


def test_every_setting_stands_in_the_pages() -> None:
    text = (ROOT / "docs" / "settings.md").read_text(encoding="utf-8")
    assert [s.name for s in list_settings() if f"`{s.name}`" not in text] == []
    commands = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"## mapmyworld {name}\n" not in commands] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", ["docs/index.md", "docs/looking.md", "docs/gates.md", "docs/json.md", "README.md"]
)
def test_what_a_page_shows_works(page: str, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order in which a reader meets them: the first page's maps serve the next ones."""
    monkeypatch.chdir(desk)
    if page != "README.md" and page != "docs/index.md" and not Path("apartment.db").exists():
        assert run("mapmyworld build sample_logs/apartment.mcap -o apartment.db -q")[0] == 0
    shown = list(shown_in(page))
    assert shown
    for command in shown:
        status, _, err = run(command.line)
        assert status == command.status, f"{command.line}\n{err}"
        assert "Traceback" not in err


@pytest.mark.slow
def test_a_newcomer_gets_from_a_wrong_topic_to_a_report(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Install is `doctor`; then the demo, an own bag, a wrong topic, what helps, the report."""
    monkeypatch.chdir(desk)
    assert run("mapmyworld doctor")[0] == 0
    status, out, _ = run("mapmyworld build drive.bag --dry-run")
    assert status == 0
    topic = re.search(r"^ *scan[: ]+(/\S+)", out, re.MULTILINE)
    assert topic, out
    status, _, err = run("mapmyworld build drive.bag -o new.db --set sensing.scan_topic=/scann")
    assert status == 2
    assert "/scann" in err
    assert topic[1] in err, "the message must name the topic that there is"
    assert len(err.strip().splitlines()) < 12
    status, _, err = run(
        f"mapmyworld build drive.bag -o new.db -q --set sensing.scan_topic={topic[1]}"
    )
    assert status == 0, err
    page = Path("new.html").read_text(encoding="utf-8")
    assert "sensing.scan_topic" in page
    assert f"--set sensing.scan_topic={topic[1]}" in page


@pytest.mark.slow
def test_the_python_page_runs(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "python.md", "exec"), names)
    assert Path("drive.png").stat().st_size > 1000
    assert np.isfinite(names["sigmas"]).all()  # type: ignore[call-overload]
