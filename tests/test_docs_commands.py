"""Every command that the pages show is one that the program knows, and does what they say."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import click
import numpy as np
import pytest
from conftest import ROOT
from docs_commands import Shown, every_line, pages, run, shown_in
from docs_desk import lay
from sample_maps import apartment  # noqa: F401

from cli.main import COMMANDS, group
from formats.database import open_store
from mapmyworld.config.settings import list_settings

# What cannot be run here, and why; everything else is.
NOT_RUN = {"--scheduler": "needs a cluster and an object store"}
# What reads or makes meshes, for which Open3D and its system libraries are needed.
OF_MESHES = ("export mesh", "--world ")
# Added to what would take minutes: a shorter drive, fewer images.
SHORTER = {"simulate": "--set camera.rate=1", "simulate --route": "--route 1,0"}


@pytest.fixture(scope="session")
def laid(tmp_path_factory: pytest.TempPathFactory, apartment: Path) -> Path:  # noqa: F811
    folder = tmp_path_factory.mktemp("laid")
    lay(folder, apartment)
    return folder


@pytest.fixture
def desk(laid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A reader's own copy of the folder, where the reader is, at home."""
    shutil.copytree(laid, tmp_path / "desk", symlinks=True)
    monkeypatch.chdir(tmp_path / "desk")
    monkeypatch.setenv("HOME", str(tmp_path / "desk"))
    return tmp_path / "desk"


def with_images(line: str) -> str:
    """The command, its nodes' numbers being those of nodes with images."""
    if not re.search(r"--pair|inspect node .*--image", line):
        return line
    with open_store(Path("office.db"), read_only=True) as store:
        seen = [str(n.id) for n in store.nodes() if store.node_data(n.id).images]
    return line.replace("--pair 3 17", f"--pair {seen[0]} {seen[-1]}").replace(
        " 17 ", f" {seen[0]} "
    )


def shortened(line: str) -> str:
    if not line.startswith("mapmyworld simulate"):
        return line
    words = [SHORTER["simulate"]] + ([] if "--route" in line else [SHORTER["simulate --route"]])
    return " ".join([line, *words])


def test_every_command_line_is_one_that_can_be_given() -> None:
    """Commands and options exist, also in pages whose commands are not run here."""
    seen = 0
    for page, words in every_line():
        command: click.Command = group
        while words and isinstance(command, click.Group):
            context = click.Context(command)
            _, inner, rest = command.resolve_command(context, words)
            assert inner is not None, f"{page}: mapmyworld {' '.join(words)}"
            command, words = inner, rest
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


PAGES = [page for page in pages() if any(shown_in(page))]


def test_many_commands_are_shown() -> None:
    shown = [command for page in PAGES for command in shown_in(page)]
    assert len(shown) > 90
    assert len([c for c in shown if any(word in c.line for word in NOT_RUN)]) <= 1
    assert {name for name in COMMANDS if name not in {"help"}} <= {
        command.line.split()[1] for command in shown
    }


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_shows_works(page: Path, desk: Path) -> None:
    """Every command of every block, in the order in which a reader meets them."""
    lines = [c for c in shown_in(page) if not any(word in c.line for word in OF_MESHES)]
    assert failures(lines, page) == []


@pytest.mark.slow
@pytest.mark.beyond_pip
@pytest.mark.usefixtures("open3d")
def test_what_the_pages_show_of_meshes_works(desk: Path) -> None:
    shutil.copy(desk / "map.db", desk / "office.db")  # which other commands of the page make
    reported = []
    for page in PAGES:
        lines = [c for c in shown_in(page) if any(word in c.line for word in OF_MESHES)]
        reported += failures(lines, page)
    assert reported == []


def failures(commands: list[Shown], page: Path) -> list[str]:
    """What the commands that ended otherwise than the page says had to say."""
    failed = []
    for command in commands:
        if any(word in command.line for word in NOT_RUN):
            continue
        # Whether an example's requirement holds depends on the map; that it is judged does not.
        allowed = command.statuses
        if " check " in command.line and page.name == "commands.md":
            allowed = (*allowed, 4)
        made = re.match(r"mapmyworld (?:convert|simulate) .*-o (\S+)", command.line)
        if made:  # a reader's folder does not hold yet what the reader is about to record
            Path(made[1]).unlink(missing_ok=True)
        status, _, err = run(with_images(shortened(command.line)))
        if status not in allowed or "Traceback" in err:
            failed.append(f"{command.line}: {status}\n{err}")
    return failed


@pytest.mark.slow
def test_a_newcomer_gets_from_a_wrong_topic_to_a_report(desk: Path) -> None:
    """Install is `doctor`; then the demo, an own bag, a wrong topic, what helps, the report."""
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
def test_the_python_page_runs(desk: Path) -> None:
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "python.md", "exec"), names)
    assert Path("drive.png").stat().st_size > 1000
    assert np.isfinite(names["sigmas"]).all()  # type: ignore[call-overload]
