"""Our values as Foxglove's protobuf messages (https://docs.foxglove.dev/docs/sdk/schemas)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudMessage
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
from mapmyworld.types import CameraModel, OccupancyGrid, PointCloud

Floats = NDArray[np.float64]
_UINT8, _FLOAT32 = PackedElementField.UINT8, PackedElementField.FLOAT32
# Cell values as red, green, blue, alpha: free, occupied, unknown.
_CELLS = {0: (245, 245, 245, 255), 100: (25, 25, 25, 255), -1: (128, 128, 128, 90)}


def timestamp(stamp_ns: int) -> Timestamp:
    """Protobuf's time of nanoseconds since 1970."""
    seconds, nanos = divmod(stamp_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


def pose(matrix: Floats) -> Pose:
    """Position and quaternion of a pose (4, 4)."""
    return Pose(position=Vector3(**_xyz(matrix[:3, 3])), orientation=_quaternion(matrix))


def transform(stamp_ns: int, parent: str, child: str, parent_from_child: Floats) -> FrameTransform:
    """The child frame's pose (4, 4) in the parent frame."""
    return FrameTransform(
        timestamp=timestamp(stamp_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(**_xyz(parent_from_child[:3, 3])),
        rotation=_quaternion(parent_from_child),
    )


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
        fields=_fields(("red", "green", "blue", "alpha"), _UINT8, 1),
        data=colours.tobytes(),
    )


def cloud(stamp_ns: int, frame: str, points: PointCloud) -> CloudMessage:
    """Points with the colours they have, in 16 bytes each."""
    colours = points.colours
    row: list[tuple[str, Any]] = [(name, "<f4") for name in "xyz"]
    fields = _fields("xyz", _FLOAT32, 4)
    if colours is not None:
        names = ("red", "green", "blue", "alpha")
        row += [(name, "u1") for name in names]
        fields += _fields(names, _UINT8, 1, 12)
    rows = np.zeros(len(points.points), row)
    for k, name in enumerate("xyz"):
        rows[name] = points.points[:, k]
    if colours is not None:
        for k, name in enumerate(("red", "green", "blue")):
            rows[name] = colours[:, k]
        rows["alpha"] = 255
    return CloudMessage(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=pose(np.eye(4)),
        point_stride=rows.dtype.itemsize,
        fields=fields,
        data=rows.tobytes(),
    )


def path(stamp_ns: int, frame: str, poses: Floats) -> PosesInFrame:
    """Poses (N, 4, 4) of one frame."""
    return PosesInFrame(
        timestamp=timestamp(stamp_ns), frame_id=frame, poses=[pose(matrix) for matrix in poses]
    )


def jpeg(stamp_ns: int, frame: str, data: bytes) -> CompressedImage:
    """A JPEG file as it is."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return CompressedImage(timestamp=timestamp(stamp_ns), frame_id=frame, data=data, format=kind)


def calibration(stamp_ns: int, frame: str, camera: CameraModel) -> CameraCalibration:
    """The camera's intrinsics and distortion."""
    k = camera.intrinsics
    return CameraCalibration(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        width=camera.width,
        height=camera.height,
        distortion_model=camera.distortion_model,
        D=camera.distortion.tolist(),
        K=k.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([k, np.zeros(3)]).ravel().tolist(),
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


def _fields(names: Sequence[str], kind: Any, size: int, start: int = 0) -> list[PackedElementField]:
    return [
        PackedElementField(name=name, offset=start + size * k, type=kind)
        for k, name in enumerate(names)
    ]
