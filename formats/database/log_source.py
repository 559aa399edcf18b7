"""A database as a log: its raw data and odometry, so that its map can be built anew."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.database.foreign import RtabmapStore
from formats.database.log_messages import Moment, messages_at
from formats.database.opening_maps import open_store
from formats.database.store import DatabaseStore
from formats.logs.listed_log import ListedLog
from mapmyworld.errors import LogError, MapError
from mapmyworld.types import NodeData, RawMessage


def open_database_log(path: Path) -> DatabaseLog:
    """The log in a database of RTAB-Map's, or in a map of ours.

    Raises `LogError` where it cannot be read.
    """
    try:
        return DatabaseLog(open_store(path, read_only=True))
    except MapError as error:
        raise LogError(str(error)) from None


class DatabaseLog(ListedLog):
    """A LogSource over a database; images are decoded when a message is.

    Raises `LogError` where it holds no nodes.
    """

    encoding = "rtabmap"

    def __init__(self, store: DatabaseStore | RtabmapStore) -> None:
        self._store = store
        foreign = isinstance(store, RtabmapStore)
        self.container = "RTAB-Map database" if foreign else "map of mapmyworld"
        super().__init__(store.path)

    def _read(self) -> Callable[[], Iterator[RawMessage]]:
        moments = _moments(self._store)
        if not moments:
            raise LogError(f"{self.path}: holds no nodes, so there is nothing to build from")
        return partial(self._messages, moments)

    def _messages(self, moments: Sequence[Moment]) -> Iterator[RawMessage]:
        self.problems[:] = self._store.problems
        mounts: dict[str, NDArray[np.float64]] = {}
        for moment in moments:
            yield from messages_at(moment, self._data(moment), mounts)

    def _data(self, moment: Moment) -> NodeData:
        """What was sensed at a moment; a damaged part is a loss, not an end."""
        try:
            data = (
                self._store.node_data(moment.node.id, features=False)
                if moment.is_node
                else NodeData()
            )
            kept = dict(self._store.scans([moment.index]))
        except MapError as error:
            self.problems.append(f"{error}: left out")
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
