"""The report: one page on a finished map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from formats.report.contents import ReportContents
from formats.report.evidence import card, definitions
from formats.report.map_layers import layers_of, map_svg, view_of
from formats.report.page import figures, folded, notes, page_html, paragraph, table
from formats.report.page_data import cloud_data, page_data
from formats.whole_files import utf8_of

_LISTED = 200  # rejected constraints listed one by one
_WORST = 10
_CELLS = (
    '<span class="cells-shown"><span class="cell free">free</span>'
    '<span class="cell occupied">occupied</span><span class="cell">unknown</span></span>'
)
_EDITING = (
    "A closure that is wrong, or wrongly rejected: its button copies the lines that say so. Put "
    "them into a file, write the reason, and give mapmyworld edit MAP FILE."
)


def report_html(contents: ReportContents) -> str:
    """The page. Only its data block `timing` differs between two builds of the same map."""
    state = "problem" if contents.problems else "fine"
    first, stop, rest = contents.verdict.partition(". ")
    reported = f"<b>{escape(first + stop)}</b>{escape(rest)}"
    cloud = cloud_data(contents.cloud)
    again = f"<pre>{escape(contents.reproduce)}</pre>" if contents.reproduce else ""
    sections: list[Sequence[str]] = [
        ("", f'<p class="verdict-line {state}">{reported}</p>'),
        ("", notes(contents.problems)),
        ("", figures(contents.headline)),
        ("", _products(contents)),
        ("The map", _map(contents)),
        ("The cloud", _cloud(cloud)),
        ("Notes", notes(contents.notes)),
        ("Diagnosis of the sensors", _diagnosis(contents)),
        ("The log", table(("what", "choice", "why"), contents.decisions)),
        ("Closures", _kinds(contents), *_evidence(contents)),
        ("Residuals", *_fit(contents)),
        ("Uncertainty", _chart("sigma") if contents.nodes.sigmas_m is not None else ""),
        ("Settings that differ", *_settings(contents)),
        ("Reproduce this map", again),
        # An empty place: the script fills it from the block that may differ between builds.
        ("Time and memory", '<div id="timing"></div>' if contents.timing else ""),
        ("Optimality", paragraph(contents.proof)),
    ]
    data = {"data": page_data(contents), "cloud-data": cloud, "timing-data": contents.timing}
    made_by = f"made by mapmyworld {contents.version}"
    return page_html(f"Map {contents.name}", made_by, sections, data)


def _products(contents: ReportContents) -> str:
    links = "".join(
        f'<li><a href="{escape(quote(href, errors="surrogateescape"))}">'
        f"{escape(utf8_of(PurePath(href).name).decode())}</a> {escape(what)}</li>"
        for href, what in contents.products
    )
    return f'<ul class="products">{links}</ul>' if links else ""


def _map(contents: ReportContents) -> str:
    view = view_of(contents)
    layers = layers_of(contents, view)
    boxes = "".join(
        f'<label class="swatch-{layer.key}"><input type="checkbox" data-layer="{layer.key}"'
        f"{' checked' if layer.shown else ''}>{escape(layer.title)}</label>"
        for layer in layers
    )
    return (
        f'<div id="layers">{boxes}{_CELLS}</div>{definitions(contents)}'
        f'<div id="map-frame">{map_svg(layers, view)}'
        '<div id="zoom" hidden><button type="button" data-by="1.6" aria-label="closer">+</button>'
        '<button type="button" data-by="0.625" aria-label="farther">−</button>'
        '<button type="button" data-by="0" aria-label="everything">⤢</button></div>'
        '<div id="tip" role="status" hidden></div></div>'
        '<div id="time" hidden><button type="button" id="play" aria-label="play">▶</button>'
        '<input type="range" id="clock" min="0" max="1000" value="0" aria-label="time">'
        '<output id="moment"></output></div><div id="seen" hidden></div>'
    )


def _kinds(contents: ReportContents) -> str:
    tried = Counter(str(c.kind) for c in contents.constraints)
    good = Counter(str(c.kind) for c in contents.constraints if c.accepted)
    rows = [
        (kind.replace("_", " "), tried[kind], good[kind], tried[kind] - good[kind])
        for kind in tried
    ]
    return table(("kind", "tried", "accepted", "rejected"), rows)


def _evidence(contents: ReportContents) -> list[str]:
    accepted = [e for e in contents.evidence if contents.constraints[e.index].accepted]
    rejected = [e for e in contents.evidence if not contents.constraints[e.index].accepted]
    parts = []
    for title, items in (
        (f"{len(accepted)} accepted closures, those that moved most first", accepted),
        (f"{len(rejected)} rejected ones, those that came closest first", rejected),
    ):
        cards = "".join(card(item, contents) for item in items)
        if cards:
            heading = f"<h3>{escape(title)}</h3>"
            parts.append(f'{heading}<div class="cards" tabindex="0">{cards}</div>')
    if contents.evidence_left_out:
        parts.append(
            paragraph(
                f"{contents.evidence_left_out:,} more accepted closures stand on the map: hover "
                "over one for its facts"
            )
        )
    if any("data-edit" in part for part in parts):
        parts.insert(0, paragraph(_EDITING))
    parts.append(_rejected(contents))
    return parts


def _rejected(contents: ReportContents) -> str:
    rejected = [c for c in contents.constraints if not c.accepted]
    rows = [(f"{c.from_id} and {c.to_id}", str(c.kind), c.reason) for c in rejected[:_LISTED]]
    more = len(rejected) - len(rows)
    listed = table(("nodes", "kind", "why"), rows)
    if more > 0:
        listed += paragraph(f"and {more:,} more: mapmyworld inspect graph --all")
    return folded(f"all {len(rejected):,} rejected constraints, with reasons", listed)


def _fit(contents: ReportContents) -> list[str]:
    known = [c for c in contents.constraints if c.residual is not None and c.accepted]
    if not known:
        return []
    worst = sorted(known, key=lambda c: -(c.residual or (0, 0, 0))[2])[:_WORST]
    rows = [
        (f"{c.from_id} and {c.to_id}", str(c.kind), *(c.residual or ()), c.reason) for c in worst
    ]
    reported = [
        f"{kind.replace('_', ' ')}: normalised residual {factor:.2f} (1 = consistent)"
        for kind, factor in contents.overconfidence.items()
    ]
    titles = ("nodes", "kind", "m", "deg", "sigmas", "accepted because")
    return [
        _chart("residuals"),
        notes(reported),
        folded("ten largest residuals", table(titles, rows)),
    ]


def _chart(key: str) -> str:
    return f'<div class="chart" id="chart-{key}"></div>'


def _cloud(cloud: dict[str, Any] | None) -> str:
    if cloud is None:
        return ""
    text = f"{cloud['count']:,} of {cloud['of']:,} points. Drag to turn, scroll or pinch to zoom."
    return f'<canvas id="cloud" tabindex="0" aria-label="point cloud"></canvas>{paragraph(text)}'


def _diagnosis(contents: ReportContents) -> str:
    """What the sensors indicate about one another."""
    items = ""
    for good, text, suggestion in contents.diagnosis:
        state, word = ("fine", "well") if good else ("problem", "look")
        more = f"<br>What to do: {escape(suggestion)}." if suggestion else ""
        items += f'<li class="{state}"><b>{word}</b> {escape(text)}{more}</li>'
    reported = paragraph(
        "Measured along the tracked path and in some images. "
        "mapmyworld inspect log does it without making a map."
    )
    return f'<ul class="diagnosis">{items}</ul>{reported}' if items else ""


def _settings(contents: ReportContents) -> list[str]:
    if not contents.settings:
        return [paragraph("None: all settings have their defaults.")]
    return [table(("setting", "here", "default"), contents.settings)]


def ellipses_of(covariances: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Half axes and angle in the map (N, 3), m and rad, of covariances (N, 2, 2), node's frame.

    Nodes have `yaw` (N,) in the map.
    """
    values, vectors = np.linalg.eigh(covariances)
    angle = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) + yaw
    halves = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return np.column_stack([halves, angle])
