"""The report in a real browser: it opens without a word, its layers toggle, its facts show."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import skip_without_browser
from database_samples import fill
from sample_maps import apartment  # noqa: F401

from cli.report import report_contents
from formats.database import open_store
from formats.edit_files import read_edits
from formats.report.page import embedded_json
from formats.report.report_page import report_html
from mapmyworld.types import ConstraintKind, Judge, Judged, Verdict, Why
from mapmyworld.types.edits import EditAction

pytestmark = pytest.mark.beyond_pip
skip_without_browser("18 tests of the report")

NASTY = '</script><script>document.title="broken"</script><img src=x onerror=alert(1)>&"'
PHONE = {"width": 390, "height": 844}
DESKTOP = {"width": 1280, "height": 900}
# Where on the screen a place of the map is, once the map is in the middle of it.
_SPOT = """([x, y]) => {
  const map = document.getElementById("map");
  map.scrollIntoView({ block: "center" });
  const box = map.getBoundingClientRect(), view = map.viewBox.baseVal;
  const fit = Math.min(box.width / view.width, box.height / view.height);
  const dx = (box.width - view.width * fit) / 2, dy = (box.height - view.height * fit) / 2;
  const u = (x - map.dataset.left) * map.dataset.scale * fit;
  const v = (map.dataset.top - y) * map.dataset.scale * fit;
  return [box.left + dx + u, box.top + dy + v];
}"""


class Opened:
    """A page, and everything that it complained about."""

    def __init__(self, browser: Any, path: Path, **options: Any) -> None:
        self.page = browser.new_page(**{"viewport": DESKTOP} | options)
        self.page.set_default_timeout(10_000)
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda r: self.requests.append(r.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]", state="attached")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """The report of three nodes, with text that would break a careless page."""
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
        bad = Judged(
            1,
            3,
            ConstraintKind.LOOP_CLOSURE,
            np.eye(4),
            np.eye(6),
            verdicts=(Verdict(Judge.PERSON, False, Why.REJECTED_BY_HAND, note=NASTY),),
        )
        store.add_constraints([bad])
        plan = {"decisions": [{"role": NASTY, "choice": NASTY, "reason": NASTY}]}
        store.put("plan", plan | {"warnings": [NASTY], "losses": [NASTY]})
        bad_wheel = {"good": False, "text": "0.9 of the distance", "suggestion": NASTY}
        store.put("diagnosis", [{"good": True, "text": NASTY, "suggestion": ""}, bad_wheel])
        stage = {"name": NASTY, "wall_s": 1.0, "cpu_s": 1.0, "peak_memory_mb": 1.0, "rounds": 1}
        merged = {**stage, "stages": [stage]}  # of which no log's duration is known
        page = report_html(replace(report_contents(store), timing=merged))
    (tmp_path / "map.html").write_text(page)
    return tmp_path / "map.html"


@pytest.fixture
def opened(browser: Any, small: Path) -> Iterator[Opened]:
    found = Opened(browser, small)
    yield found
    found.page.close()


def test_no_complaint_and_nothing_from_elsewhere(opened: Opened) -> None:
    assert opened.complaints == []
    assert [url for url in opened.requests if not url.startswith(("file:", "data:"))] == []


def test_text_from_a_log_stays_text(opened: Opened) -> None:
    assert opened.page.title() == "Map map.db"
    assert opened.page.locator("img").count() == 0
    assert opened.page.evaluate("document.body.innerText").count("onerror=alert") >= 4


def test_what_the_log_was_diagnosed_with_stands_with_its_suggestion_first(opened: Opened) -> None:
    reported = opened.page.locator("ul.diagnosis li").all_inner_texts()
    assert len(reported) == 2
    assert reported[0].startswith("look 0.9 of the distance")
    assert "What to do" in reported[0]
    assert reported[1].startswith("well ")


def test_layers_go_and_come(opened: Opened) -> None:
    page = opened.page
    path = page.locator('g[data-layer="path"]')
    assert path.is_visible()
    page.locator('#layers input[data-layer="path"]').uncheck()
    assert path.get_attribute("hidden") is not None
    page.locator('#layers input[data-layer="path"]').check()
    assert path.get_attribute("hidden") is None
    assert page.locator('g[data-layer="rejected"]').get_attribute("hidden") is not None


def test_hovering_over_a_node_shows_its_facts(opened: Opened) -> None:
    page = opened.page
    node = page.evaluate(
        "(({ id, x, y }) => [id[1], x[1], y[1]])"
        "(JSON.parse(document.getElementById('data').textContent).nodes)"
    )
    spot = page.evaluate(_SPOT, node[1:])
    page.mouse.move(spot[0], spot[1])
    tip = page.locator("#tip")
    tip.wait_for(state="visible")
    assert f"node {node[0]}" in tip.inner_text()


def test_buttons_zoom_and_the_slider_moves_the_robot(opened: Opened) -> None:
    page = opened.page
    page.locator('#zoom button[data-by="1.6"]').click()
    page.wait_for_function(
        "document.getElementById('view').getAttribute('transform').includes('scale(1.6)')"
    )
    page.locator("#clock").fill("500")
    assert page.locator("#marks .robot").count() == 1
    assert "node" in page.locator("#moment").inner_text()


def test_the_scale_bar_keeps_to_round_numbers(opened: Opened) -> None:
    """It said "1.3 m" once the map was zoomed."""
    page, seen = opened.page, set()
    for _ in range(6):
        bar = page.locator("#scale-bar")
        metres = float(bar.locator("text").text_content().removesuffix(" m"))
        power = 10 ** math.floor(math.log10(metres) + 1e-9)
        assert round(metres / power, 6) in {1, 2, 5}
        length = float(bar.locator("path").get_attribute("d").partition("h")[2])
        scale = page.evaluate("+document.getElementById('map').dataset.scale")
        zoomed = page.evaluate(
            "+(/scale\\(([^)]*)\\)/.exec(document.getElementById('view')"
            ".getAttribute('transform') || 'scale(1)')[1])"
        )
        assert length == pytest.approx(metres * scale * zoomed, rel=0.01)
        seen.add(metres)
        page.locator('#zoom button[data-by="1.6"]').click()
        page.wait_for_timeout(400)
    assert len(seen) > 2


def test_free_stays_lighter_than_unknown_in_the_dark(browser: Any, small: Path) -> None:
    """Darkness turned them round: free was black upon unknown grey."""
    with open_store(small.with_suffix(".db"), read_only=True) as store:
        grid = store.grid()
    assert grid is not None
    cells, places = grid.trinary(), {}
    for name, value in (("free", 0), ("unknown", -1), ("occupied", 100)):
        row, column = np.argwhere(cells == value)[0]
        places[name] = grid.origin + (np.array([column, row]) + 0.5) * grid.resolution
    shades = {}
    for scheme in ("light", "dark"):
        page = Opened(browser, small, color_scheme=scheme).page
        for key in ("path", "start", "loop", "proximity", "user"):
            page.evaluate("key => document.querySelector(`g[data-layer=${key}]`)?.remove()", key)
        for name, (x, y) in places.items():
            left, top = page.evaluate(_SPOT, [x, y])
            clip = {"x": left, "y": top, "width": 1, "height": 1}
            pixel = cv2.imdecode(np.frombuffer(page.screenshot(clip=clip), np.uint8), 0)
            shades[scheme, name] = int(pixel[0, 0])
        page.close()
    for scheme in ("light", "dark"):
        assert shades[scheme, "free"] > shades[scheme, "unknown"] + 20, shades
        assert abs(shades[scheme, "occupied"] - shades[scheme, "free"]) > 60, shades
    assert shades["dark", "free"] < 100  # and it is dark


def test_a_button_copies_a_rejection(browser: Any, small: Path, tmp_path: Path) -> None:
    found = Opened(browser, small)
    page = found.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    button = page.locator("article.card.accepted button.edit").first
    button.scroll_into_view_if_needed()
    assert button.text_content() == "copy [[reject]]"
    button.click()
    page.wait_for_function(
        "[...document.querySelectorAll('button.edit')].some((b) => b.textContent === 'copied')"
    )
    (tmp_path / "edits.toml").write_text(page.evaluate("navigator.clipboard.readText()"))
    (edit,) = read_edits(tmp_path / "edits.toml")
    assert edit.action is EditAction.REJECT
    assert found.complaints == []
    page.close()


def test_dark_and_light_differ(browser: Any, small: Path) -> None:
    shades = []
    for scheme in ("light", "dark"):
        found = Opened(browser, small, color_scheme=scheme)
        ask = "getComputedStyle(document.body).backgroundColor"
        shades.append(found.page.evaluate(ask))
        found.page.locator("#theme").click()
        shades.append(found.page.evaluate(ask))
        found.page.close()
    assert shades[0] == shades[3]
    assert shades[1] == shades[2]
    assert shades[0] != shades[1]


def test_a_phone_needs_no_scrolling_sideways(browser: Any, small: Path) -> None:
    found = Opened(browser, small, viewport=PHONE, is_mobile=True, has_touch=True)
    wide = found.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    found.page.close()
    assert wide <= 0
    assert found.complaints == []


def test_the_page_stands_without_its_script(browser: Any, small: Path) -> None:
    page = browser.new_page(java_script_enabled=False)
    page.goto(small.as_uri())
    assert page.locator("#map polyline").count() >= 1
    assert page.locator("article.card").count() >= 1
    page.close()


def test_it_prints(browser: Any, small: Path) -> None:
    found = Opened(browser, small, color_scheme="dark")
    pdf = found.page.pdf(format="A4")
    found.page.close()
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) >= 1


def test_data_cannot_end_their_element() -> None:
    text = embedded_json({"reason": NASTY})
    assert "<" not in text
    assert json.loads(text) == {"reason": NASTY}


@pytest.mark.slow
def test_the_report_of_a_real_build(
    browser: Any,
    apartment: Path,  # noqa: F811
) -> None:
    path = apartment.with_suffix(".html")
    found = Opened(browser, path)
    page = found.page
    page.locator("#cloud").scroll_into_view_if_needed()
    page.wait_for_selector("#cloud[data-ready]")
    page.locator("#timing table").wait_for()
    assert page.locator(".chart canvas").count() == 2
    diagnosed = page.locator("ul.diagnosis").inner_text()
    assert "of the distance that odometry reports" in diagnosed
    assert "the floor is tilted by" in diagnosed
    assert page.locator("article.card.accepted").count() >= 3
    assert page.locator("article.card.rejected").count() >= 3
    assert page.locator("svg.pair path").count() >= 1
    assert page.locator("svg.scans").count() >= 4
    card = page.locator("article.card:has(svg.pair path)").first
    card.scroll_into_view_if_needed()  # cards are drawn when they are scrolled to
    page.wait_for_timeout(200)
    facts = card.inner_text()
    for said in (
        r"\d+ and \d+ features",
        r"\d+ of \d+ matches agree",
        r"\d+ visual words in common",
    ):
        assert re.search(said, facts), facts
    reported = page.locator("main").inner_text()
    for said in (
        "Settings that differ", "mapmyworld build apartment.mcap", "content hash", "peak memory",
        "rejected ones, those that came closest first", "ten largest residuals",
        "normalised residual",
    ):  # fmt: skip
        assert said in reported, said
    assert found.complaints == []
    page.close()


@pytest.mark.slow
def test_a_still_cloud_is_not_drawn_again(
    browser: Any,
    apartment: Path,  # noqa: F811
) -> None:
    """A page that was left open kept a core busy; turned by hand, the cloud follows."""
    page = Opened(browser, apartment.with_suffix(".html")).page
    page.evaluate(
        """() => { window.frames_drawn = 0; const ask = window.requestAnimationFrame;
          window.requestAnimationFrame = (f) => { window.frames_drawn += 1; return ask(f); }; }"""
    )
    page.locator("#cloud").scroll_into_view_if_needed()
    page.wait_for_selector("#cloud[data-ready]")
    page.wait_for_timeout(2500)
    page.evaluate("window.frames_drawn = 0")
    page.wait_for_timeout(500)
    assert page.evaluate("window.frames_drawn") == 0
    before = page.locator("#cloud").screenshot()
    box = page.locator("#cloud").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 50, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 200, box["y"] + 80, steps=5)
    page.mouse.up()
    page.wait_for_timeout(300)
    assert page.evaluate("window.frames_drawn") > 0
    assert page.locator("#cloud").screenshot() != before
    page.close()


@pytest.mark.slow
def test_the_cloud_is_on_paper_too(browser: Any, apartment: Path) -> None:  # noqa: F811
    """It is drawn when it is scrolled to, and paper is never scrolled."""
    found = Opened(browser, apartment.with_suffix(".html"))
    assert found.page.locator("#cloud[data-ready]").count() == 0
    found.page.pdf(format="A4")
    assert found.page.locator("#cloud[data-ready]").count() == 1
    pixels = found.page.evaluate(
        """() => {
          const canvas = document.getElementById("cloud"), gl = canvas.getContext("webgl2")
            || canvas.getContext("webgl");
          const data = new Uint8Array(4 * canvas.width * canvas.height);
          gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, data);
          return data.reduce((count, v, i) => count + (i % 4 === 3 && v > 0), 0);
        }"""
    )
    found.page.close()
    assert pixels > 5000
    assert found.complaints == []


@pytest.mark.slow
def test_a_build_indicates_its_time_apart_from_the_map(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """All but the last block is the same for every build of the same map."""
    with open_store(apartment, read_only=True) as store:
        started = time.process_time()
        contents = report_contents(store)
        again = report_html(replace(report_contents(store), timing={"stages": [], "wall_s": 1.0}))
        assert time.process_time() - started < 10.0
    assert len(contents.evidence) > 5

    def without_timing(page: str) -> str:
        return re.sub(r'<script type="application/json" id="timing-data">.*', "", page)

    written = apartment.with_suffix(".html").read_text()
    assert without_timing(written) == without_timing(again)
    assert len(written) < 8e6
    stages = json.loads(apartment.with_suffix(".timing.json").read_text())["stages"]
    assert {"track", "optimise"} <= {stage["name"].split()[0] for stage in stages} | {"optimise"}
    assert all(stage["wall_s"] >= 0 for stage in stages)
