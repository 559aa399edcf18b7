"""A self-contained HTML page: no script, no font, no picture from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

_STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8881; --accent: #1666b0; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
p.sub { margin-top: 0; opacity: .7; }
dl.figures { display: flex; flex-wrap: wrap; gap: .6rem; }
dl.figures div { border: 1px solid var(--line); border-radius: .4rem; padding: .4rem .9rem; }
dl.figures dt { font-size: .8rem; opacity: .7; } dl.figures dd { margin: 0; font-size: 1.2rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .25rem .7rem .25rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
td.number, th.number { text-align: right; }
figure { margin: 1rem 0; } figcaption { font-size: .9rem; opacity: .8; }
svg, img { max-width: 100%; height: auto; } figure svg { background: #fff; border-radius: .4rem; }
.row { display: flex; flex-wrap: wrap; gap: .6rem; } .row figure { flex: 1 1 14rem; margin: 0; }
.key { display: inline-block; width: .9rem; height: .25rem; vertical-align: middle; }
details summary { cursor: pointer; color: var(--accent); margin: .5rem 0; }
ul.notes li { margin: .2rem 0; }
""".strip()


@dataclass(slots=True)
class Page:
    """Sections in the order in which they are added."""

    title: str
    subtitle: str = ""
    _parts: list[str] = field(default_factory=list)

    def section(self, heading: str, *html: str) -> None:
        """A heading and ready-made HTML under it; left out when there is nothing under it."""
        body = "\n".join(part for part in html if part)
        if body:
            self._parts.append(f"<h2>{escape(heading)}</h2>\n{body}")

    def add(self, html: str) -> None:
        """Ready-made HTML without a heading."""
        self._parts.append(html)

    def html(self) -> str:
        """The page."""
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)}</title>\n<style>\n{_STYLE}\n</style>\n</head>\n<body>\n"
            f"<h1>{escape(self.title)}</h1>\n"
            f'<p class="sub">{escape(self.subtitle)}</p>\n'
            + "\n".join(self._parts)
            + "\n</body>\n</html>\n"
        )


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
    return f"<table>\n<tr>{titles}</tr>\n" + "\n".join(lines) + "\n</table>"


def _cell(value: str | int | float) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    text = f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
    return f'<td class="number">{text}</td>'


def notes(lines: Sequence[str]) -> str:
    """A list of sentences."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<ul class="notes">{items}</ul>' if items else ""


def picture(content: str, caption: str) -> str:
    """A figure of ready-made SVG or an <img>."""
    return f"<figure>{content}<figcaption>{caption}</figcaption></figure>"


def side_by_side(parts: Sequence[str]) -> str:
    return f'<div class="row">{"".join(parts)}</div>' if parts else ""


def folded(summary: str, html: str) -> str:
    """What is seen after a click."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>" if html else ""


def data_uri(data: bytes) -> str:
    """A PNG or JPEG as part of the page."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def image(data: bytes, alt: str) -> str:
    return f'<img alt="{escape(alt)}" src="{data_uri(data)}">'
