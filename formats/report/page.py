"""A self-contained HTML page: no script, no font, no picture from elsewhere."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from types import MappingProxyType
from typing import Any

from formats.readable import readable


def page_html(
    title: str,
    subtitle: str,
    sections: Iterable[Sequence[str]],
    data: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """The page: of each section a heading, if it has one, and ready-made HTML under it.

    Sections with nothing under them are left out. `data` are values that the page's script reads;
    they stand last, one block a line.
    """
    parts, links = [], ""
    for heading, *html in sections:
        body = "\n".join(part for part in html if part)
        if body and heading:
            key = "".join(c if c.isalnum() else "-" for c in heading.lower())
            links += f'<a href="#{key}">{escape(readable(heading))}</a>'
            body = f'<section id="{key}"><h2>{escape(heading)}</h2>\n{body}</section>'
        parts += [body] if body else []
    title, subtitle = (escape(readable(text)) for text in (title, subtitle))
    blocks = "\n".join(
        f'<script type="application/json" id="{name}">{embedded_json(value)}</script>'
        for name, value in data.items()
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n"
        f"<style>\n{_asset('uPlot.min.css')}\n{_asset('report.css')}</style>\n"
        '<script>document.documentElement.classList.toggle("dark",'
        ' matchMedia("(prefers-color-scheme: dark)").matches)</script>\n'
        f"</head>\n<body>\n<header><h1>{title}</h1>\n"
        f'<p class="sub">{subtitle}</p>\n<nav>{links}'
        '<button id="theme" type="button" hidden>dark</button></nav></header>\n<main>\n'
        + readable("\n".join(parts))
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
