"""A self-contained HTML page: no script, no font, no picture from elsewhere."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from typing import Any

from formats.readable import readable


@dataclass(slots=True)
class Page:
    """Sections in the order in which they are added."""

    title: str
    subtitle: str = ""
    _parts: list[str] = field(default_factory=list)
    _contents: list[tuple[str, str]] = field(default_factory=list)
    _data: list[tuple[str, str]] = field(default_factory=list)

    def section(self, heading: str, *html: str) -> None:
        """A heading and ready-made HTML under it; left out when there is nothing under it."""
        body = "\n".join(part for part in html if part)
        if body:
            key = "".join(c if c.isalnum() else "-" for c in heading.lower())
            self._contents.append((key, heading))
            title = f"<h2>{escape(heading)}</h2>"
            self._parts.append(f'<section id="{key}">{title}\n{body}</section>')

    def add(self, html: str) -> None:
        """Ready-made HTML without a heading."""
        self._parts.append(html)

    def data(self, name: str, value: Any) -> None:
        """Values that the page's script reads."""
        self._data.append((name, embedded_json(value)))

    def html(self) -> str:
        """The page; its data stand last, one block a line."""
        links = "".join(
            f'<a href="#{key}">{escape(readable(name))}</a>' for key, name in self._contents
        )
        title, subtitle = (escape(readable(text)) for text in (self.title, self.subtitle))
        blocks = "\n".join(
            f'<script type="application/json" id="{name}">{text}</script>'
            for name, text in self._data
        )
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{title}</title>\n"
            f"<style>\n{_asset('uPlot.min.css')}\n{_asset('report.css')}</style>\n"
            f"</head>\n<body>\n<header><h1>{title}</h1>\n"
            f'<p class="sub">{subtitle}</p>\n<nav>{links}'
            '<button id="theme" type="button" hidden>dark</button></nav></header>\n<main>\n'
            + readable("\n".join(self._parts))
            + f"\n</main>\n<script>{_asset('libraries.min.js')}</script>\n{blocks}\n"
            + f"<script>\n{_asset('report.js')}</script>\n</body>\n</html>\n"
        )


def _asset(name: str) -> str:
    return resources.files("formats.report").joinpath("assets", name).read_text("utf-8")


def embedded_json(value: Any) -> str:
    """JSON that no text in it can end the element in which it stands."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def figures(pairs: Iterable[tuple[str, str]]) -> str:
    """A row of named figures."""
    cells = (f"<div><dt>{escape(n)}</dt><dd>{escape(v)}</dd></div>" for n, v in pairs)
    return f'<dl class="figures">{"".join(cells)}</dl>'


def table(head: Sequence[str], rows: Iterable[Sequence[str | int | float]]) -> str:
    """A table; numbers stand to the right. Empty without rows."""
    body = [[_cell(value) for value in row] for row in rows]
    if not body:
        return ""
    lines = ["<tr>" + "".join(cells) + "</tr>" for cells in body]
    numeric = ['class="number"' in cell for cell in body[0]]
    titles = "".join(
        f"<th{' class=number' if right else ''}>{escape(name)}</th>"
        for name, right in zip(head, numeric, strict=True)
    )
    body_html = "\n".join(lines)
    return f'<div class="table"><table>\n<tr>{titles}</tr>\n{body_html}\n</table></div>'


def _cell(value: str | int | float) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    text = f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
    return f'<td class="number">{text}</td>'


def notes(lines: Sequence[str]) -> str:
    """A list of sentences."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<ul class="notes">{items}</ul>' if items else ""


def paragraph(text: str) -> str:
    """A sentence; nothing for an empty one."""
    return f"<p>{escape(text)}</p>" if text else ""


def folded(summary: str, html: str) -> str:
    """What is seen after a click."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>" if html else ""


def data_uri(data: bytes) -> str:
    """A PNG or JPEG as part of the page."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
