"""Which closures a report shows closely, and what is fetched for them."""

from __future__ import annotations

import itertools
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from formats.report.contents import Evidence, ImageMatches, NodePicture
from mapmyworld.errors import MapMyWorldError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.geometry.rigid import between
from mapmyworld.parallel import in_threads
from mapmyworld.types import (
    ConstraintKind,
    ImageMatch,
    ImageMessage,
    Judged,
    MapStore,
    Node,
    ScanMatch,
)

if TYPE_CHECKING:
    from mapmyworld.places.node_pairs import NodePair

_LOOPS = (ConstraintKind.LOOP_CLOSURE, ConstraintKind.USER, ConstraintKind.PROXIMITY)
_ACCEPTED = 400  # shown closely; the rest of a large map stand on the map only
_REJECTED = 24
_COMPARED = 48  # pairs of images that are matched again for their picture, 0.1 s each
_ALONG = 40  # images along the path, for the slider
_WIDTHS = ((120, 320), (300, 240), (10**9, 160))  # pictures at most -> pixels across


@dataclass(frozen=True, slots=True, eq=False)
class Fetched:
    """Evidence and the material it refers to."""

    evidence: tuple[Evidence, ...]
    left_out: int
    pictures: Mapping[int, NodePicture]
    scans: Mapping[int, NDArray[np.float32]]
    """Node id -> points (N, 2), base frame, metres."""


def fetch_evidence(store: MapStore, constraints: Sequence[Judged]) -> Fetched:
    """The closures that moved the map most, and the rejected ones that came closest."""
    nodes = {node.id: node for node in store.nodes()}
    chosen, left_out = _chosen(constraints, nodes)
    wanted = {i for k in chosen for i in (constraints[k].from_id, constraints[k].to_id)}
    along = np.linspace(0, len(nodes) - 1, min(_ALONG, len(nodes))).astype(int)
    ids = list(nodes)
    asked = sorted(wanted | {ids[k] for k in along.tolist()})
    scans: dict[int, NDArray[np.float32]] = {}
    pictures = _pictures(_images(store, asked, wanted, scans), len(asked))
    matches = _matches(store, {k: constraints[k] for k in chosen}, scans)
    evidence = []
    for k in chosen:
        tracked, measured = _by_tracking(constraints[k], nodes), constraints[k].i_from_j
        ways = (matrix_to_planar(tracked), matrix_to_planar(measured))
        evidence.append(Evidence(k, *ways, matches.get(k)))
    return Fetched(tuple(evidence), left_out, pictures, scans)


def _images(
    store: MapStore,
    asked: Iterable[int],
    wanted: Container[int],
    scans: dict[int, NDArray[np.float32]],
) -> Iterator[tuple[int, ImageMessage]]:
    """Images of nodes, one after the other: together they would fill the memory.

    The scans of the `wanted` nodes are put into `scans` on the way.
    """
    for i in asked:
        data = store.node_data(i, features=False)
        if i in wanted and data.scan is not None and len(data.scan.points):
            scans[i] = data.scan.points
        if data.images and data.images[0].colour is not None:
            yield i, data.images[0].colour


def _chosen(constraints: Sequence[Judged], nodes: Mapping[int, Node]) -> tuple[list[int], int]:
    """Places of the constraints that are shown, accepted first; how many accepted are not."""
    loops = [
        k
        for k, c in enumerate(constraints)
        if c.kind in _LOOPS and {c.from_id, c.to_id} <= nodes.keys()
    ]
    accepted = [k for k in loops if constraints[k].accepted]
    # Recognised places before those that the path's own estimate proposed.
    accepted.sort(
        key=lambda k: (
            constraints[k].kind == ConstraintKind.PROXIMITY,
            -_moved(constraints[k], nodes),
        )
    )
    rejected = [k for k in loops if not constraints[k].accepted]
    rejected.sort(key=lambda k: _nearly(constraints[k]), reverse=True)
    shown = accepted[:_ACCEPTED]
    shown.sort(key=lambda k: -_moved(constraints[k], nodes))
    return shown + rejected[:_REJECTED], len(accepted) - len(shown)


def _moved(c: Judged, nodes: Mapping[int, Node]) -> float:
    """Metres by which tracking alone had missed what the constraint measures."""
    return float(np.linalg.norm(_by_tracking(c, nodes)[:3, 3] - c.i_from_j[:3, 3]))


def _by_tracking(c: Judged, nodes: Mapping[int, Node]) -> Array:
    """What the constraint measures (4, 4), by tracking alone."""
    return between(nodes[c.from_id].tracked_from_base, nodes[c.to_id].tracked_from_base)


def _nearly(c: Judged) -> tuple[float, float]:
    """How far a rejected constraint got: matches or overlap, then its score."""
    match c.source:
        case ScanMatch(overlap=overlap, score=score):
            return overlap, score
        case ImageMatch(inliers=inliers):
            return inliers / 100.0, 0.0
    return 0.0, 0.0


def _matches(
    store: MapStore, shown: Mapping[int, Judged], scans: Container[int]
) -> dict[int, ImageMatches]:
    """What the images of the first of those found by images share, looked at once more."""
    by_images = {
        k: (c.from_id, c.to_id)
        for k, c in shown.items()
        if isinstance(c.source, ImageMatch) or c.from_id not in scans or c.to_id not in scans
    }
    if not by_images:
        return {}
    from mapmyworld.config import Config
    from mapmyworld.places.node_pairs import compare_pairs

    found = zip(by_images, compare_pairs(store, by_images.values(), Config()), strict=True)
    compared = ((k, _shared(pair)) for k, pair in found if pair is not None)
    return dict(itertools.islice(compared, _COMPARED))


def _shared(found: NodePair) -> ImageMatches:
    a, b, pair = found.features_a, found.features_b, found.pair
    common = 0
    if a.words is not None and b.words is not None:
        common = len(np.intersect1d(a.words[a.words > 0], b.words[b.words > 0]))
    return ImageMatches(
        a.pixels[pair.features_a],
        b.pixels[pair.features_b],
        pair.agreed,
        common,
        (len(a.pixels), len(b.pixels)),
    )


def _pictures(images: Iterable[tuple[int, ImageMessage]], count: int) -> dict[int, NodePicture]:
    """Small pictures of the nodes' images, about `count`."""
    width = next(width for most, width in _WIDTHS if count <= most)

    def small(item: tuple[int, ImageMessage]) -> tuple[int, NodePicture | None]:
        from formats.report.match_picture import node_picture

        try:
            return item[0], node_picture(item[1], width)
        except (MapMyWorldError, ValueError):
            return item[0], None  # a damaged image: the page says so by leaving it out

    made = in_threads(small, images, 0)
    return {i: picture for i, picture in made if picture is not None}
