"""What stands in the report, read without a browser."""

from __future__ import annotations

import base64
import html
import re
from dataclasses import replace
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest
from database_samples import fill
from room_drive import drive

from cli.checking import Facts, measure
from cli.inspect_map import map_facts
from cli.report import report_contents, write_report
from formats.database import open_store
from formats.edit_files import read_edits
from formats.logs import open_log
from formats.report.map_layers import layers_of, view_of
from formats.report.report_page import report_html
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.exporting import export_beside
from mapmyworld.pipeline import build_map
from mapmyworld.types import ConstraintKind
from mapmyworld.types.edits import EditAction


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a short drive, with what stands beside it."""
    folder = tmp_path_factory.mktemp("a room's")
    drive(60).write(folder / "room.mcap")
    with open_store(folder / "map.db", create=True) as store:
        build_map(open_log([folder / "room.mcap"]), store, Config(), Silent())
        export_beside(store, folder / "map.db", Config())
        write_report(store, folder / "map.html")
    return folder / "map.db"


def test_the_head_says_when_how_large_and_how_fine(room: Path) -> None:
    with open_store(room, read_only=True) as store:
        shown, grid = dict(report_contents(store).headline), store.grid()
        begun = store.nodes()[0].stamp_ns
    assert grid is not None
    height, width = (0.05 * cells for cells in grid.log_odds.shape)
    assert shown["size"] == f"{width:.1f} m x {height:.1f} m"
    assert shown["resolution"] == "0.05 m"
    free = (grid.trinary() == 0).sum() * 0.05**2
    assert shown["free area"] == f"{free:.1f} m²"
    date = np.datetime64(begun, "ns").astype("datetime64[m]").item().strftime("%Y-%m-%d %H:%M UTC")
    assert shown["recorded"] == date


def test_a_clock_that_knows_no_date_gives_none(tmp_path: Path) -> None:
    """Simulations begin at 0: 1970 is when nothing was recorded."""
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        nodes = [replace(node, stamp_ns=5 * 10**9) for node in store.nodes()]
        store.nodes = lambda: tuple(nodes)  # type: ignore[method-assign]
        assert "recorded" not in dict(report_contents(store).headline)


def test_products_are_links_that_lead_there(room: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "page.html"
    with open_store(room, read_only=True) as store:
        write_report(store, elsewhere)
    for page in (room.with_suffix(".html"), elsewhere):
        links = re.findall(r'<ul class="products">.*?</ul>', page.read_text(), re.DOTALL)[0]
        found = [html.unescape(link) for link in re.findall(r'href="([^"]*)"', links)]
        names = {Path(link).name for link in found}
        assert names == {"map.db", "map.pgm", "map.yaml", "map.tum"}
        assert not any(" " in link for link in found)
        assert all((page.parent / link.replace("%20", " ").replace("%27", "'")).exists()
                   for link in found)  # fmt: skip


def test_the_verdict_stands_first_and_the_proof_last(room: Path) -> None:
    text = room.with_suffix(".html").read_text()
    sections = re.findall(r"<h2>(.*?)</h2>", text)
    assert sections[0] == "The map"
    assert sections[-1] == "Optimality"
    verdict = re.findall(r'<p class="verdict-line \w+">(.*?)</p>', text)[0]
    assert re.sub("<[^>]*>", "", verdict).startswith(("A whole map.", "A partial map:"))
    assert "optimality" not in verdict
    assert "Global optimality" in text.rpartition("<h2>")[2].partition("</section>")[0]


def test_a_card_holds_the_edit_that_turns_its_verdict_round(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        contents = report_contents(store)
    page = report_html(contents)
    texts = [html.unescape(text) for text in re.findall(r'data-edit="([^"]*)"', page)]
    shown = [contents.constraints[item.index] for item in contents.evidence]
    measured = [one for one in shown if one.kind != ConstraintKind.USER]  # the rest is a person's
    assert len(shown) > len(measured) > 0
    in_order = sorted(measured, key=lambda one: not one.accepted)
    for text, closure in zip(texts, in_order, strict=True):
        (tmp_path / "edits.toml").write_text(text)
        (edit,) = read_edits(tmp_path / "edits.toml")
        assert (edit.from_id, edit.to_id, edit.kind) == (
            closure.from_id, closure.to_id, closure.kind,
        )  # fmt: skip
        wanted = EditAction.REJECT if closure.accepted else EditAction.ACCEPT
        assert edit.action is wanted


def test_unknown_cells_let_the_page_through(room: Path) -> None:
    """Their shade is the page's, so that darkness cannot turn them round with the free ones."""
    with open_store(room, read_only=True) as store:
        contents = report_contents(store)
    (layer,) = (one for one in layers_of(contents, view_of(contents)) if one.key == "grid")
    data = base64.b64decode(re.findall(r"base64,([^\"]*)", layer.svg)[0])
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[::-1]
    assert contents.grid is not None
    cells = contents.grid.trinary()
    assert (pixels[cells == -1][:, 3] == 0).all()
    assert (pixels[cells == 0] == 255).all()
    assert (pixels[cells == 100][:, 0] < 60).all()


def test_every_layer_has_a_colour_of_its_own() -> None:
    css = resources.files("formats.report").joinpath("assets", "report.css").read_text()
    for theme in re.findall(r"color-scheme: (?:light|dark); --page[^}]*}", css)[:3]:
        colours = dict(re.findall(r"--([a-z]+): (#[0-9a-f]{3,6});", theme))
        drawn = ["path", "node", "loop", "proximity", "rejected", "odometry", "user", "sigma"]
        if set(drawn) <= set(colours):
            assert len({colours[name] for name in drawn}) == len(drawn)
    assert ".layer-nodes path { stroke: var(--node)" in css


def test_figures_of_area_are_one_function(room: Path) -> None:
    with open_store(room, read_only=True) as store:
        shown = dict(report_contents(store).headline)["free area"]
        facts = map_facts(store)["grid"]["free_m2"]
        measured = measure({"free_area"}, Facts(store, room, {}))
    assert facts == measured["free_area"]
    assert shown == f"{facts:.1f} m²"


def test_what_every_stage_noted_is_shown_once(tmp_path: Path) -> None:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        for key in ("track", "wheels", "solve"):
            store.put(key, {"notes": [f"of {key}", "of all"]})
        assert report_contents(store).notes == ["of track", "of all", "of wheels", "of solve"]
