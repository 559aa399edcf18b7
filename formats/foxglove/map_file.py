"""A finished map as an MCAP file that Foxglove's 3D panel draws at once."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.constraint_kinds import COLOURS, REJECTED
from formats.database.image_blobs import encode_picture
from formats.recording_files import LogWriter
from formats.ros_messages import Fields, header, pose_in_map, pose_of, vector
from formats.whole_files import write_whole
from mapmyworld.geometry import Array
from mapmyworld.types import (
    ConstraintKind,
    Judged,
    Node,
    NodeData,
    OccupancyGrid,
    PointCloud,
    PointCloudMessage,
    TransformsMessage,
    TransformStamped,
)
from mapmyworld.types.wording import reason_of

MAP = "map"
_LISTED = 60  # constraints of a kind whose facts its lines hold
_LINE_LIST = 5  # visualization_msgs/Marker: lines between pairs of points
_LINE_WIDTH = 0.03  # m
Event = tuple[int, str, Any]
"""Time in nanoseconds, topic, message."""


@dataclass(frozen=True, slots=True, eq=False)
class FoxgloveMap:
    """What is written."""

    base_frame: str
    stamps_ns: NDArray[np.int64]
    """(F,) of the tracked frames."""
    map_from_base: Array
    """(F, 4, 4)."""
    nodes: Sequence[tuple[Node, Array, Array | None]]
    """Each with map_from_node and its covariance (6, 6), rotation first, in its own frame."""
    constraints: Sequence[Judged]
    grid: OccupancyGrid | None
    cloud: PointCloud | None


def write_foxglove(path: Path, shown: FoxgloveMap, data: Iterable[NodeData]) -> list[Path]:
    """Writes the map and a layout beside it; `data` of the nodes, in their order, one at a time."""
    with LogWriter(path, overwrite=True) as writer:
        path_poses = zip(shown.stamps_ns.tolist(), shown.map_from_base, strict=True)
        tf = ((at_ns, "/tf", transform(at_ns, MAP, shown.base_frame, p)) for at_ns, p in path_poses)
        moving = heapq.merge(tf, node_events(shown, data), key=itemgetter(0))
        for time_ns, topic, message in chain(map_events(shown), moving):
            writer.write(topic, message, time_ns)
    return [path, write_layout(path)]


def write_layout(path: Path) -> Path:
    """The panels that show the map, for Foxglove's "import layout"."""
    beside = path.with_suffix(".layout.json")
    write_whole(beside, json.dumps(layout(), indent=1) + "\n")
    return beside


def map_events(shown: FoxgloveMap) -> Iterator[Event]:
    """Grid, cloud, path and graph, all at the first frame or node."""
    stamps = [*shown.stamps_ns[:1].tolist(), *(node.stamp_ns for node, _, _ in shown.nodes)]
    start = min(stamps, default=0)
    if len(shown.map_from_base):
        yield start, "/tf", transform(start, MAP, shown.base_frame, shown.map_from_base[0])
    if shown.grid is not None:
        yield start, "/map/grid", ("nav_msgs/msg/OccupancyGrid", _grid(start, shown.grid))
    if shown.cloud is not None:
        cloud = PointCloudMessage(start, MAP, shown.cloud.points, shown.cloud.colours)
        yield start, "/map/cloud", cloud
    yield start, "/map/path", ("nav_msgs/msg/Path", _path(start, shown))
    markers = list(_markers(start, shown))
    yield start, "/map/graph", ("visualization_msgs/msg/MarkerArray", {"markers": markers})


def transform(stamp_ns: int, parent: str, child: str, pose: Array) -> TransformsMessage:
    """The child frame's pose (4, 4) in the parent frame."""
    return TransformsMessage((TransformStamped(stamp_ns, parent, child, pose),), static=False)


def _grid(start: int, grid: OccupancyGrid) -> Fields:
    corner = np.eye(4)
    corner[:2, 3] = grid.origin
    cells = grid.trinary()
    info = {"resolution": grid.resolution, "width": cells.shape[1], "height": cells.shape[0]}
    return {
        "header": header(start, MAP),
        "info": {**info, "origin": pose_of(corner)},
        "data": cells,
    }


def _path(start: int, shown: FoxgloveMap) -> Fields:
    poses = [
        {"header": header(stamp, MAP), "pose": pose_of(pose)}
        for stamp, pose in zip(shown.stamps_ns.tolist(), shown.map_from_base, strict=True)
    ]
    return {"header": header(start, MAP), "poses": poses}


def _rgba(colour: str, opacity: float = 1.0) -> Fields:
    parts = [part / 255.0 for part in bytes.fromhex(colour[1:])]
    return dict(zip("rgba", [*parts, opacity], strict=True))


def _markers(start: int, shown: FoxgloveMap) -> Iterator[Fields]:
    """One for each kind of accepted constraint, one for all rejected ones; facts as their texts."""
    place = {node.id: pose[:3, 3] for node, pose, _ in shown.nodes}
    groups = [
        (str(kind), _rgba(colour), [c for c in shown.constraints if c.accepted and c.kind == kind])
        for kind, colour in COLOURS.items()
    ]
    groups.append(
        ("rejected", _rgba(REJECTED, 0.4), [c for c in shown.constraints if not c.accepted])
    )
    for name, colour, members in groups:
        drawn = [c for c in members if {c.from_id, c.to_id} <= place.keys()]
        if drawn:
            facts = [f"{len(members)} constraints"]
            if name != str(ConstraintKind.NEIGHBOUR):
                facts += [f"{c.from_id} and {c.to_id}: {reason_of(c)}" for c in drawn[:_LISTED]]
            yield {
                "header": header(start, MAP),
                "ns": name,
                "type": _LINE_LIST,
                "pose": pose_of(np.eye(4)),
                "scale": {"x": _LINE_WIDTH},
                "color": colour,
                "frame_locked": True,
                "points": [vector(place[end]) for c in drawn for end in (c.from_id, c.to_id)],
                "text": "\n".join(facts),
            }


def node_events(shown: FoxgloveMap, data: Iterable[NodeData]) -> Iterator[Event]:
    """Each node's pose and colour images, with their cameras, as `data` comes."""
    for (node, pose, covariance), item in zip(shown.nodes, data, strict=True):
        known = np.zeros((6, 6)) if covariance is None else covariance
        at_ns = node.stamp_ns
        yield at_ns, "/map/pose", pose_in_map(at_ns, pose, known)
        for index, image in enumerate(item.images):
            if image.colour is None:
                continue
            frame, encoded = f"{shown.base_frame}/camera{index}", image.colour.encoded
            if not encoded:
                encoded = encode_picture(np.asarray(image.colour.pixels(), np.uint8), "jpeg", 90)
            picture = replace(image.colour, stamp_ns=at_ns, frame_id=frame, encoded=encoded)
            topic, mount = f"/map/camera{index}", image.camera.base_from_camera
            yield at_ns, "/tf", transform(at_ns, shown.base_frame, frame, mount)
            yield at_ns, f"{topic}/info", image.camera.info(at_ns, frame)
            yield at_ns, f"{topic}/image", picture


_TOPICS = ("/map/grid", "/map/cloud", "/map/path", "/map/graph", "/map/pose")


def layout() -> dict[str, Any]:
    """As Foxglove's "Import from file" reads it."""
    topics: dict[str, Any] = {name: {"visible": True} for name in _TOPICS}
    topics["/map/cloud"] |= {"pointSize": 3, "colorMode": "rgb", "colorField": "rgb"}
    topics["/map/path"] |= {"type": "line", "lineWidth": 0.03, "gradient": ["#1f6fd1", "#1f6fd1"]}
    topics["/map/pose"] |= {"showCovariance": True, "type": "axis", "axisScale": 0.3}
    scene = {
        "followMode": "follow-none",
        "fixedFrame": "map",
        "followTf": "map",
        "scene": {"transforms": {"showLabel": False}},
        "cameraState": {"perspective": True, "distance": 40, "phi": 35, "thetaOffset": 0},
        "topics": topics,
    }
    image = {
        "imageMode": {"imageTopic": "/map/camera0/image", "calibrationTopic": "/map/camera0/info"}
    }
    return {
        "configById": {"3D!map": scene, "Image!node": image},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "first": "3D!map",
            "second": "Image!node",
            "direction": "row",
            "splitPercentage": 70,
        },
    }
