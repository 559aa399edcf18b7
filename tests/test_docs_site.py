"""The pages as a site: every link and picture is there, every page is in the contents."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from ruamel.yaml import YAML

import mapmyworld


def test_every_page_is_in_the_contents() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"[\w/-]+\.md", YAML(typ="safe").load(text)["nav"].__repr__()))
    there = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert named <= there
    assert {page for page in there - named if not page.startswith("benchmarks/")} == set()


def test_pictures_are_small_enough_to_load() -> None:
    for path in (ROOT / "docs" / "images").iterdir():
        assert path.stat().st_size < 300_000, path.name


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built pages; a warning would have ended the build."""
    pytest.importorskip("mkdocs", reason="no mkdocs: the site is not built")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_builds_without_a_warning(site: Path) -> None:
    assert (site / "index.html").is_file()
    assert not list(site.rglob("*.py"))


@pytest.mark.slow
def test_equations_are_part_of_the_pages(site: Path) -> None:
    """MathML, made while the site is built; what TeX it does not know would stand there as text."""
    pages = {
        page: re.findall("<math.*?</math>", page.read_text(encoding="utf-8"), re.DOTALL)
        for page in site.rglob("index.html")
    }
    assert sum(map(len, pages.values())) > 15
    for page, equations in pages.items():
        assert not re.search(r"\\[(\[]", page.read_text("utf-8").split("<article")[-1]), page
        assert [e for e in equations if re.search(r">\\[a-zA-Z]", e)] == [], page


@pytest.mark.slow
def test_every_public_name_is_on_the_page_of_the_api(site: Path) -> None:
    page = (site / "api" / "index.html").read_text(encoding="utf-8")
    public = [getattr(mapmyworld, name) for name in mapmyworld.__all__ if name != "__version__"]
    names = {f"{one.__module__}.{one.__qualname__}" for one in public}
    assert names - set(re.findall(r'<h3 id="([\w.]+)"', page)) == set()


@pytest.mark.slow
def test_the_pages_of_the_api_show_what_docstrings_say_of_arrays(site: Path) -> None:
    page = (site / "api-values" / "index.html").read_text(encoding="utf-8")
    field = page.split('id="mapmyworld.types.frames.Scan.points"')[1]
    assert "(N, 2) returns, metres, base frame" in field[:2000]


@pytest.mark.slow
@pytest.mark.beyond_pip
def test_the_site_asks_nobody_else_for_anything(site: Path, browser: Any) -> None:
    asked: list[str] = []
    page = browser.new_page()
    page.on("request", lambda request: asked.append(request.url))
    for name in ("index.html", "stages/track/index.html", "settings/index.html", "api/index.html"):
        page.goto((site / name).as_uri())
        page.wait_for_load_state("load")
    assert page.locator("h1").is_visible()
    page.close()
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
