"""A database as a log: its raw data and odometry, so that its map can be built anew."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.database.foreign import RtabmapStore
from formats.database.opening import open_store
from formats.database.store import DatabaseStore
from formats.database.sweeps import message_from_scan
from mapmyworld.errors import LogError, MapError
from mapmyworld.geometry import planar_to_matrix
from mapmyworld.types import (
    CameraInfoMessage,
    CameraModel,
    ImageMessage,
    LogInfo,
    Message,
    MessageKind,
    Node,
    NodeData,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    RawMessage,
    RgbdImage,
    TopicInfo,
    TransformsMessage,
    TransformStamped,
)

_BASE, _ODOM, _LASER = "base_link", "odom", "laser"
_TYPES = {
    MessageKind.TRANSFORMS: "tf2_msgs/msg/TFMessage",
    MessageKind.ODOMETRY: "nav_msgs/msg/Odometry",
    MessageKind.POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
    MessageKind.CAMERA_INFO: "sensor_msgs/msg/CameraInfo",
    MessageKind.IMAGE: "sensor_msgs/msg/Image",
    MessageKind.LASER_SCAN: "sensor_msgs/msg/LaserScan",
    MessageKind.POINT_CLOUD: "sensor_msgs/msg/PointCloud2",
}
_ENCODING = "rtabmap"
_HASHED_AT_ONCE = 1 << 20


def open_database_log(path: Path) -> DatabaseLog:
    """The log in a database of RTAB-Map's, or in a map of ours."""
    try:
        return DatabaseLog(open_store(path, read_only=True))
    except MapError as error:
        raise LogError(str(error)) from None


@dataclass(frozen=True, slots=True)
class _Moment:
    """A tracked frame: its node, where it was, and whether it is that node itself."""

    index: int
    stamp_ns: int
    node: Node
    odom_from_base: NDArray[np.float64]
    is_node: bool


class DatabaseLog:
    """A LogSource over a database; images are decoded when a message is."""

    def __init__(self, store: DatabaseStore | RtabmapStore) -> None:
        self._store = store
        self._moments = _moments(store)
        if not self._moments:
            raise LogError(f"{store.path}: holds no nodes, so there is nothing to build from")
        self._losses: list[str] = []

    def info(self) -> LogInfo:
        counts: dict[str, tuple[MessageKind, int]] = {}
        for raw in self._first_messages():
            counts[raw.topic] = (raw.kind, self._count(raw))
        topics = tuple(
            TopicInfo(topic, _TYPES[kind], kind, _ENCODING, count)
            for topic, (kind, count) in counts.items()
        )
        path = self._store.path
        foreign = isinstance(self._store, RtabmapStore)
        return LogInfo(
            paths=(str(path),),
            container="RTAB-Map database" if foreign else "map of mapmyworld",
            size_bytes=path.stat().st_size,
            message_count=sum(topic.count for topic in topics),
            start_ns=self._moments[0].stamp_ns,
            end_ns=self._moments[-1].stamp_ns,
            topics=topics,
            problems=self._store.problems,
        )

    def _first_messages(self) -> Iterator[RawMessage]:
        """One message of each topic, from the first node that has it."""
        seen: set[str] = set()
        for raw in self.messages():
            if raw.topic not in seen:
                seen.add(raw.topic)
                yield raw
            if raw.stamp_ns is not None and raw.stamp_ns > self._moments[0].stamp_ns + 10**10:
                return

    def _count(self, raw: RawMessage) -> int:
        """How many of its topic there are, where the tables tell without reading blobs."""
        if raw.kind is MessageKind.TRANSFORMS:
            return 1
        if raw.kind is MessageKind.ODOMETRY:
            return len(self._moments)
        if raw.kind is MessageKind.LASER_SCAN and isinstance(self._store, DatabaseStore):
            return self._store.scan_count()
        key = {MessageKind.LASER_SCAN: "scan", MessageKind.POINT_CLOUD: "cloud"}.get(raw.kind)
        if raw.kind is MessageKind.POSE:
            return sum(m.is_node and m.node.ground_truth is not None for m in self._moments)
        contents = self._store.contents().values()
        return sum(int(bool(kept.get(key or "images", 0))) for kept in contents)

    def content_hash(self) -> str:
        digest = hashlib.sha256()
        with self._store.path.open("rb") as file:
            while block := file.read(_HASHED_AT_ONCE):
                digest.update(block)
        return digest.hexdigest()

    def losses(self) -> tuple[str, ...]:
        return tuple(self._losses)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        self._losses = list(self._store.problems)
        mounts: dict[str, NDArray[np.float64]] = {}
        for moment in self._moments:
            for raw in self._messages_at(moment, mounts):
                if topics is None or raw.topic in topics:
                    yield raw

    def _messages_at(
        self, moment: _Moment, mounts: dict[str, NDArray[np.float64]]
    ) -> Iterator[RawMessage]:
        data = self._data(moment)
        fresh = {name: at for name, at in _mounts(data).items() if name not in mounts}
        if fresh:
            mounts |= fresh
            yield _raw("/tf_static", MessageKind.TRANSFORMS, moment, lambda: _static(moment, fresh))
        yield _raw("/odom", MessageKind.ODOMETRY, moment, lambda: _odometry(moment))
        if moment.is_node and moment.node.ground_truth is not None:
            yield _raw("/ground_truth", MessageKind.POSE, moment, lambda: _truth(moment))
        for number, image in enumerate(data.images):
            yield from _camera_messages(moment, number, image)
        scan, cloud = data.scan, data.cloud
        if scan is not None:
            yield _raw(
                "/scan",
                MessageKind.LASER_SCAN,
                moment,
                lambda: message_from_scan(scan, moment.stamp_ns, _LASER),
            )
        if cloud is not None:
            yield _raw(
                "/points",
                MessageKind.POINT_CLOUD,
                moment,
                lambda: PointCloudMessage(moment.stamp_ns, _BASE, cloud, None),
            )

    def _data(self, moment: _Moment) -> NodeData:
        """What was sensed at a moment; a damaged part is a loss, not an end."""
        try:
            data = self._store.node_data(moment.node.id) if moment.is_node else NodeData()
            kept = dict(self._store.scans([moment.index]))
        except MapError as error:
            self._losses.append(f"{error}: left out")
            return NodeData()
        return NodeData(kept.get(moment.index, data.scan), data.images, data.cloud)


def _moments(store: DatabaseStore | RtabmapStore) -> list[_Moment]:
    """Every tracked frame in time; its odometry as recorded, else continued from its node's."""
    nodes = {node.id: node for node in store.nodes()}
    frames = store.tracked_frames()
    moments = []
    for i, node_id in enumerate(frames.node_ids.tolist()):
        if node_id in nodes:
            if frames.odom_from_base is not None:
                odom = frames.odom_from_base[i]
            else:
                odom = nodes[node_id].odom_from_base @ frames.node_from_frame[i]
            stamp_ns, is_node = int(frames.stamps_ns[i]), bool(frames.is_node[i])
            moments.append(_Moment(i, stamp_ns, nodes[node_id], odom, is_node))
    return moments


def _raw(
    topic: str, kind: MessageKind, moment: _Moment, decode: Callable[[], Message]
) -> RawMessage:
    return RawMessage(topic, kind, moment.stamp_ns, moment.stamp_ns, decode)


def _mounts(data: NodeData) -> dict[str, NDArray[np.float64]]:
    """Sensor frame -> base_from_sensor."""
    mounts = {
        _camera_frame(i): image.camera.base_from_camera for i, image in enumerate(data.images)
    }
    if data.scan is not None:
        mounts[_LASER] = planar_to_matrix(data.scan.origin)
    return mounts


def _static(moment: _Moment, mounts: dict[str, NDArray[np.float64]]) -> TransformsMessage:
    return TransformsMessage(
        tuple(TransformStamped(moment.stamp_ns, _BASE, name, at) for name, at in mounts.items()),
        static=True,
    )


def _odometry(moment: _Moment) -> OdometryMessage:
    unknown = np.zeros((6, 6))
    pose, twist = moment.odom_from_base, np.zeros(6)
    return OdometryMessage(moment.stamp_ns, _ODOM, _BASE, pose, unknown, twist, unknown)


def _truth(moment: _Moment) -> PoseMessage:
    truth = moment.node.ground_truth
    assert truth is not None
    return PoseMessage(moment.stamp_ns, "world", truth, np.zeros((6, 6)))


def _camera_frame(number: int) -> str:
    return "camera_optical" if number == 0 else f"camera_{number}_optical"


def _camera_messages(moment: _Moment, number: int, image: RgbdImage) -> Iterator[RawMessage]:
    """Info, colour and depth of one camera; the second and later have topics of their own."""
    space = "/camera" if number == 0 else f"/camera_{number}"
    frame, model = _camera_frame(number), image.camera
    stamp = image.colour or image.depth
    at = moment.stamp_ns if stamp is None else stamp.stamp_ns
    yield _raw(
        f"{space}/rgb/camera_info", MessageKind.CAMERA_INFO, moment, lambda: _info(model, at, frame)
    )
    for kind, picture in (("rgb", image.colour), ("depth", image.depth)):
        if picture is not None:
            yield _picture(f"{space}/{kind}/image", moment, picture, frame)


def _picture(topic: str, moment: _Moment, picture: ImageMessage, frame: str) -> RawMessage:
    message = ImageMessage(
        picture.stamp_ns,
        frame,
        picture.encoding,
        picture.width,
        picture.height,
        picture.pixels,
        picture.encoded,
    )
    kind = MessageKind.IMAGE
    return RawMessage(topic, kind, moment.stamp_ns, picture.stamp_ns, lambda: message)


def _info(model: CameraModel, stamp_ns: int, frame: str) -> CameraInfoMessage:
    projection = np.column_stack([model.intrinsics, np.zeros(3)])
    return CameraInfoMessage(
        stamp_ns,
        frame,
        model.width,
        model.height,
        model.distortion_model,
        model.distortion,
        model.intrinsics,
        np.eye(3),
        projection,
    )
