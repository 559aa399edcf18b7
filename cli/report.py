"""What the HTML report says of a map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import mapmyworld
from cli.exporting import frame_poses, grid_at
from formats.report.map_picture import Lines, curve, map_picture
from formats.report.page import (
    Page,
    figures,
    folded,
    image,
    notes,
    picture,
    side_by_side,
    table,
)
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry import between
from mapmyworld.types import Constraint, MapStore, Node, OccupancyGrid, Poses

# Colours that are told apart by those who do not see red and green.
_COLOURS = {
    "loop_closure": "#d55e00",
    "proximity": "#009e73",
    "user": "#cc79a7",
    "landmark": "#e69f00",
}
_LISTED = 200  # rejected constraints shown one by one
_SHOWN_IMAGES = 4
_LOOKED_AT = 20  # frames that show whether there are scans
_THUMBNAIL = 320  # pixels across


def report_page(store: MapStore) -> str:
    """One HTML page on a finished map."""
    nodes, constraints = store.nodes(), store.constraints()
    if not nodes:
        raise MapError(f"{getattr(store, 'path', 'the map')}: holds no nodes to report on")
    frames, poses = frame_poses(store)
    stamps = store.tracked_frames().stamps_ns[frames]
    grid = _grid(store)
    name = str(getattr(store, "path", "map"))
    page = Page(f"Map {name.rsplit('/', 1)[-1]}", f"mapmyworld {mapmyworld.__version__}")
    page.add(figures(_headline(nodes, constraints, stamps, poses)))
    solved = store.poses()
    page.section("From above", *_from_above(poses, solved, grid, constraints))
    page.section("Constraints", _kinds(constraints), *_rejected(constraints))
    if solved is not None:
        page.section("How well it fits", _misfits(constraints, solved), _sigmas(nodes, solved))
    page.section("What the cameras saw", _thumbnails(store, nodes))
    page.section("How it was made", *_origin(store))
    return page.html()


def _grid(store: MapStore) -> OccupancyGrid | None:
    """The stored grid; drawn from the scans where there is none, as in RTAB-Map's files."""
    grid = store.grid()
    if grid is None and next(iter(store.scans(range(_LOOKED_AT))), None) is not None:
        grid = grid_at(store, Config(), None)
    return grid


def _headline(
    nodes: Sequence[Node],
    constraints: Sequence[Constraint],
    stamps: NDArray[np.int64],
    poses: NDArray[np.float64],
) -> list[tuple[str, str]]:
    length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
    closures = [c for c in constraints if str(c.kind) in _COLOURS]
    accepted = sum(c.accepted for c in closures)
    return [
        ("path", f"{length:.1f} m"),
        ("time", f"{(stamps[-1] - stamps[0]) * 1e-9:.0f} s" if len(stamps) else "-"),
        ("nodes", f"{len(nodes):,}"),
        ("tracked frames", f"{len(stamps):,}"),
        ("sessions", f"{len({node.session for node in nodes})}"),
        ("closures", f"{accepted:,} accepted of {len(closures):,} tried"),
    ]


def _from_above(
    poses: NDArray[np.float64],
    solved: Poses | None,
    grid: OccupancyGrid | None,
    constraints: Sequence[Constraint],
) -> tuple[str, ...]:
    kinds: list[Lines] = []
    if solved is not None:
        place = dict(zip(solved.ids.tolist(), solved.map_from_node[:, :2, 3], strict=True))
        for kind, colour in _COLOURS.items():
            ends = [
                (place[c.from_id], place[c.to_id])
                for c in constraints
                if str(c.kind) == kind and c.accepted and {c.from_id, c.to_id} <= place.keys()
            ]
            kinds.append(Lines(kind, colour, np.array(ends).reshape(-1, 2, 2)))
    key = [("path", "#1666b0")] + [
        (k.name.replace("_", " "), k.colour) for k in kinds if len(k.ends)
    ]
    caption = " &nbsp; ".join(
        f'<span class="key" style="background:{colour}"></span> {name}' for name, colour in key
    )
    return (
        picture(
            map_picture(poses[:, :2, 3], grid, kinds), f"{caption} &nbsp; green start, red end"
        ),
    )


def _kinds(constraints: Sequence[Constraint]) -> str:
    tried = Counter(str(c.kind) for c in constraints)
    accepted = Counter(str(c.kind) for c in constraints if c.accepted)
    rows = [
        (kind.replace("_", " "), tried[kind], accepted[kind], tried[kind] - accepted[kind])
        for kind in tried
    ]
    return table(("kind", "tried", "accepted", "rejected"), rows)


def _rejected(constraints: Sequence[Constraint]) -> tuple[str, ...]:
    rejected = [c for c in constraints if not c.accepted]
    rows = [(f"{c.from_id} to {c.to_id}", str(c.kind), c.reason) for c in rejected[:_LISTED]]
    more = len(rejected) - len(rows)
    listed = table(("nodes", "kind", "why"), rows) + (f"<p>and {more:,} more</p>" if more else "")
    return (folded(f"{len(rejected):,} rejected, with reasons", listed if rows else ""),)


def _misfits(constraints: Sequence[Constraint], solved: Poses) -> str:
    """The accepted closures that the solved poses meet least."""
    place = dict(zip(solved.ids.tolist(), solved.map_from_node, strict=True))
    rows = []
    for c in constraints:
        if c.accepted and c.from_id != c.to_id and {c.from_id, c.to_id} <= place.keys():
            step = between(place[c.from_id], place[c.to_id])
            off = float(np.linalg.norm(step[:3, 3] - c.from_from_to[:3, 3]))
            rows.append((f"{c.from_id} to {c.to_id}", str(c.kind), round(off, 4), c.reason))
    rows.sort(key=lambda row: -float(row[2]))
    return table(("nodes", "kind", "misfit, m", "accepted because"), rows[:10])


def _sigmas(nodes: Sequence[Node], solved: Poses) -> str:
    if solved.covariances is None:
        return ""
    stamps = {node.id: node.stamp_ns * 1e-9 for node in nodes}
    known = [i for i, node_id in enumerate(solved.ids.tolist()) if node_id in stamps]
    times = np.array([stamps[int(solved.ids[i])] for i in known])
    spread = np.trace(solved.covariances[known, 3:, 3:], axis1=1, axis2=2)
    sigma = np.sqrt(np.maximum(spread, 0.0))
    if len(times) < 2:
        return ""
    return picture(
        curve(times, sigma, "#1666b0", "m"),
        "standard deviation of the nodes' positions relative to the first node, over time",
    )


def _thumbnails(store: MapStore, nodes: Sequence[Node]) -> str:
    import cv2

    from formats.database.pictures import encode_picture

    chosen = [nodes[i] for i in np.linspace(0, len(nodes) - 1, _SHOWN_IMAGES).astype(int)]
    parts = []
    for node in dict.fromkeys(chosen):
        images = store.node_data(node.id).images
        if images and images[0].colour is not None:
            pixels = np.asarray(images[0].colour.pixels(), np.uint8)
            height = max(1, round(pixels.shape[0] * _THUMBNAIL / pixels.shape[1]))
            small = cv2.resize(pixels, (_THUMBNAIL, height), interpolation=cv2.INTER_AREA)
            data = encode_picture(np.asarray(small, np.uint8), "jpeg", 80)
            parts.append(picture(image(data, f"node {node.id}"), f"node {node.id}"))
    return side_by_side(parts)


def _origin(store: MapStore) -> tuple[str, ...]:
    plan = store.get("plan") or {}
    rows = [(d["role"], d["choice"], d["reason"]) for d in plan.get("decisions", ())]
    told = [*plan.get("warnings", ()), *plan.get("losses", ())]
    for key in ("track", "solve"):
        told += (store.get(key) or {}).get("losses", ())
    told += getattr(store, "problems", ())
    return table(("what", "choice", "why"), rows), notes(list(dict.fromkeys(told)))
