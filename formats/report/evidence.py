"""The evidence for each closure: scans laid upon each other, images with what they share."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from formats.report.contents import (
    Evidence,
    ImageMatches,
    NodePicture,
    ReportContents,
    ShownConstraint,
)
from formats.report.page import data_uri
from mapmyworld.geometry import Array
from mapmyworld.types import ConstraintKind

_POINTS = 240  # of a scan that are drawn
_SPREAD = 95.0  # percentile of a scan's ranges that its picture holds
_GAP = 6  # pixels between two images


def definitions(contents: ReportContents) -> str:
    """Every scan and image once, for the cards to refer to."""
    parts = []
    for node, points in contents.scans.items():  # in centimetres, y upwards
        kept = np.round(100.0 * points[:: max(1, -(-len(points) // _POINTS))]).astype(int)
        path = "".join(f"M{x} {y}h0" for x, y in kept.tolist())
        parts.append(f'<path id="scan{node}" d="{path}"/>')
    parts += [
        f'<image id="image{node}" width="{p.width}" height="{p.height}" href="{data_uri(p.jpeg)}"/>'
        for node, p in contents.pictures.items()
    ]
    return f'<svg class="store" aria-hidden="true"><defs>{"".join(parts)}</defs></svg>'


def card(item: Evidence, contents: ReportContents) -> str:
    """One closure: its facts, and pictures of what it rests on."""
    constraint = contents.constraints[item.index]
    pictures = _scans(constraint, item, contents) + _images(constraint, item.matches, contents)
    verdict = "accepted" if constraint.accepted else "rejected"
    kind = str(constraint.kind).replace("_", " ")
    return (
        f'<article class="card {verdict}" id="c{item.index}">'
        f"<h3>{constraint.from_id} and {constraint.to_id}"
        f' <span class="kind">{escape(kind)}</span> <span class="verdict">{verdict}</span></h3>'
        f'<div class="pictures">{"".join(pictures)}</div>'
        f"<p>{'; '.join(_facts(constraint, item.matches))}</p>"
        f'<p class="why">{escape(constraint.reason)}</p>{_edit_button(constraint)}</article>'
    )


def _edit_button(constraint: ShownConstraint) -> str:
    """Copies the edit that turns the verdict round; shown by the page's script, which copies."""
    if constraint.kind == ConstraintKind.USER:  # a person's own: the file that states it is edited
        return ""
    action = "reject" if constraint.accepted else "accept"
    text = (
        f"[[{action}]]\nfrom = {constraint.from_id}\nto = {constraint.to_id}\n"
        f'kind = "{constraint.kind}"\nreason = "by the look of the report"\n'
    )
    return (
        f'<button type="button" class="edit" data-edit="{escape(text)}" hidden>'
        f"copy [[{action}]]</button>"
    )


def _facts(constraint: ShownConstraint, matches: ImageMatches | None) -> Iterable[str]:
    if constraint.start is not None and constraint.residual is not None and constraint.accepted:
        before, after = constraint.start, constraint.residual
        yield f"residual by tracking {before[0]:.2f} m, {before[1]:.1f}°; after {after[0]:.3f} m"
    if constraint.residual is not None:
        metres, degrees, sigmas = constraint.residual
        yield f"residual {metres:.3f} m, {degrees:.2f}° ({sigmas:.1f} sigma)"
    if matches is not None:
        agreed = int(np.count_nonzero(matches.agreed))
        first, second = matches.features
        yield f"{first} and {second} features, {agreed} of {len(matches.agreed)} matches agree"
        if matches.common_words:
            yield f"{matches.common_words} visual words in common"


def _scans(constraint: ShownConstraint, item: Evidence, contents: ReportContents) -> list[str]:
    a, b = constraint.from_id, constraint.to_id
    if a not in contents.scans or b not in contents.scans:
        return []
    points = contents.scans[a]
    reach = float(np.percentile(np.abs(points), _SPREAD)) if len(points) else 1.0
    reach = 100.0 * max(reach, 0.5) * 1.15
    views = (("by tracking alone", item.start), ("as measured", item.measured))
    return [_overlay(a, b, moved, reach, caption) for caption, moved in views]


def _overlay(a: int, b: int, moved: Array, reach: float, caption: str) -> str:
    turn = f"translate({100 * moved[0]:.1f} {100 * moved[1]:.1f})"
    turn += f" rotate({np.degrees(moved[2]):.3f})"
    box = f"{-reach:.0f} {-reach:.0f} {2 * reach:.0f} {2 * reach:.0f}"
    return (
        f'<figure><svg class="scans" viewBox="{box}">'
        f'<g transform="scale(1 -1)" stroke-width="{reach / 45:.1f}">'
        f'<use class="a" href="#scan{a}"/><use class="b" href="#scan{b}" transform="{turn}"/>'
        f"</g></svg><figcaption>{caption}</figcaption></figure>"
    )


def _images(
    constraint: ShownConstraint, matches: ImageMatches | None, contents: ReportContents
) -> list[str]:
    a, b = constraint.from_id, constraint.to_id
    if a not in contents.pictures or b not in contents.pictures:
        return []
    first, second = contents.pictures[a], contents.pictures[b]
    width = first.width + _GAP + second.width
    height = max(first.height, second.height)
    lines = "" if matches is None else _match_lines(matches, first, second)
    caption = f"images of {a} and {b}"
    if matches is not None:
        caption += ": green matches agree with the motion, red ones do not"
    return [
        f'<figure class="wide"><svg class="pair" viewBox="0 0 {width} {height}">'
        f'<use href="#image{a}"/><use href="#image{b}" x="{first.width + _GAP}"/>{lines}</svg>'
        f"<figcaption>{caption}</figcaption></figure>"
    ]


def _match_lines(matches: ImageMatches, a: NodePicture, b: NodePicture) -> str:
    starts = matches.pixels_a * a.scale
    ends = matches.pixels_b * b.scale + np.array([a.width + _GAP, 0.0])
    groups = []
    for name, chosen in (("outlier", ~matches.agreed), ("inlier", matches.agreed)):
        rows = np.column_stack([starts[chosen], ends[chosen]]).tolist()
        text = "".join(f"M{x:.0f} {y:.0f}L{u:.0f} {v:.0f}" for x, y, u, v in rows)
        groups.append(f'<path class="{name}" d="{text}"/>' if text else "")
    return "".join(groups)
