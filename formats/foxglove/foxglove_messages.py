"""What no standard message of ROS shows so, as Foxglove's own (https://docs.foxglove.dev/docs/sdk/schemas).

A grid of coloured cells, a path, and lines with facts that a click shows; protobuf.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from mapmyworld.geometry.rotations import rotation_to_quaternion
from mapmyworld.types import OccupancyGrid

Floats = NDArray[np.float64]
# Cell values as red, green, blue, alpha: free, occupied, unknown.
_CELLS = {0: (245, 245, 245, 255), 100: (25, 25, 25, 255), -1: (128, 128, 128, 90)}


def timestamp(stamp_ns: int) -> Timestamp:
    """Protobuf's time of nanoseconds since 1970."""
    seconds, nanos = divmod(stamp_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


def pose(matrix: Floats) -> Pose:
    """Position and quaternion of a pose (4, 4)."""
    return Pose(position=Vector3(**_xyz(matrix[:3, 3])), orientation=_quaternion(matrix))


def grid(stamp_ns: int, frame: str, cells: OccupancyGrid) -> Grid:
    """Coloured cells, so that a viewer needs no settings."""
    values = cells.trinary()
    colours = np.zeros((*values.shape, 4), np.uint8)
    for value, colour in _CELLS.items():
        colours[values == value] = colour
    corner = np.eye(4)
    corner[:2, 3] = cells.origin
    return Grid(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=pose(corner),
        column_count=values.shape[1],
        cell_size=Vector2(x=cells.resolution, y=cells.resolution),
        row_stride=4 * values.shape[1],
        cell_stride=4,
        fields=[
            PackedElementField(name=name, offset=k, type=PackedElementField.UINT8)
            for k, name in enumerate(("red", "green", "blue", "alpha"))
        ],
        data=colours.tobytes(),
    )


def path(stamp_ns: int, frame: str, poses: Floats) -> PosesInFrame:
    """Poses (N, 4, 4) of one frame."""
    return PosesInFrame(
        timestamp=timestamp(stamp_ns), frame_id=frame, poses=[pose(matrix) for matrix in poses]
    )


def lines_entity(
    stamp_ns: int,
    frame: str,
    name: str,
    ends: Floats,
    colour: Sequence[float],
    facts: Mapping[str, str],
) -> SceneEntity:
    """Straight lines between pairs of points (L, 2, 3), with facts that a click shows."""
    line = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        pose=pose(np.eye(4)),
        thickness=2.0,
        scale_invariant=True,
        points=[Point3(**_xyz(point)) for point in ends.reshape(-1, 3)],
        color=Color(r=colour[0], g=colour[1], b=colour[2], a=colour[3]),
    )
    return SceneEntity(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        id=name,
        frame_locked=True,
        metadata=[KeyValuePair(key=key, value=value) for key, value in facts.items()],
        lines=[line],
    )


def scene(entities: Sequence[SceneEntity]) -> SceneUpdate:
    """What replaces the entities of the same names."""
    return SceneUpdate(entities=entities)


def _xyz(values: Floats) -> dict[str, float]:
    return dict(zip("xyz", values.tolist(), strict=True))


def _quaternion(matrix: Floats) -> Quaternion:
    x, y, z, w = rotation_to_quaternion(matrix[:3, :3]).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)
