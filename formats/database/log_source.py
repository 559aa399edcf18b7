"""A database as a log: its raw data and odometry, so that its map can be built anew."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.database.foreign import RtabmapStore
from formats.database.log_messages import TYPES, Moment, messages_at
from formats.database.opening_maps import open_store
from formats.database.store import DatabaseStore
from formats.logs.files import hash_files
from mapmyworld.errors import LogError, MapError
from mapmyworld.types import (
    LogInfo,
    MessageKind,
    NodeData,
    RawMessage,
    TopicInfo,
)

_ENCODING = "rtabmap"


def open_database_log(path: Path) -> DatabaseLog:
    """The log in a database of RTAB-Map's, or in a map of ours.

    Raises `LogError` where it cannot be read.
    """
    try:
        return DatabaseLog(open_store(path, read_only=True))
    except MapError as error:
        raise LogError(str(error)) from None


class DatabaseLog:
    """A LogSource over a database; images are decoded when a message is.

    Raises `LogError` where it holds no nodes.
    """

    def __init__(self, store: DatabaseStore | RtabmapStore) -> None:
        self._store = store
        self._moments = _moments(store)
        if not self._moments:
            raise LogError(f"{store.path}: holds no nodes, so there is nothing to build from")
        self._losses: list[str] = []
        self._hash: str | None = None

    def info(self) -> LogInfo:
        counts: dict[str, tuple[MessageKind, int]] = {}
        for raw in self._first_messages():
            counts[raw.topic] = (raw.kind, self._count(raw))
        topics = tuple(
            TopicInfo(topic, TYPES[kind], kind, _ENCODING, count)
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
        """How many of its topic there are, where the tables indicate without reading blobs."""
        if raw.kind is MessageKind.TRANSFORMS:
            return 1
        if raw.kind is MessageKind.ODOMETRY:
            return len(self._moments)
        if raw.kind is MessageKind.LASER_SCAN and isinstance(self._store, DatabaseStore):
            return self._store.scan_count()
        key = {MessageKind.LASER_SCAN: "scan", MessageKind.POINT_CLOUD: "cloud"}.get(raw.kind)
        if raw.kind is MessageKind.POSE:
            return sum(m.is_node and m.node.ground_truth is not None for m in self._moments)
        nodes = [moment.node for moment in self._moments if moment.is_node]
        if raw.kind is MessageKind.GPS:
            return sum(node.gps is not None for node in nodes)
        if raw.kind is MessageKind.READING:
            return sum(raw.topic.endswith(f"/{r.quantity}") for n in nodes for r in n.readings)
        contents = self._store.contents().values()
        return sum(int(bool(kept.get(key or "images", 0))) for kept in contents)

    def content_hash(self) -> str:
        if self._hash is None:
            self._hash = hash_files([self._store.path])
        return self._hash

    def losses(self) -> tuple[str, ...]:
        return tuple(self._losses)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        self._losses = list(self._store.problems)
        mounts: dict[str, NDArray[np.float64]] = {}
        for moment in self._moments:
            for raw in messages_at(moment, self._data(moment), mounts):
                if topics is None or raw.topic in topics:
                    yield raw

    def _data(self, moment: Moment) -> NodeData:
        """What was sensed at a moment; a damaged part is a loss, not an end."""
        try:
            data = self._store.node_data(moment.node.id) if moment.is_node else NodeData()
            kept = dict(self._store.scans([moment.index]))
        except MapError as error:
            self._losses.append(f"{error}: left out")
            return NodeData()
        return NodeData(kept.get(moment.index, data.scan), data.images, data.cloud)


def _moments(store: DatabaseStore | RtabmapStore) -> list[Moment]:
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
            moments.append(Moment(i, stamp_ns, nodes[node_id], odom, is_node))
    return moments
