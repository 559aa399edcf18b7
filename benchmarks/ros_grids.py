"""Grids that other programs recorded in logs, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def grid_of_bag(log: Path, path: Path) -> Path:
    """The first grid on a ROS 1 bag's /map as a YAML file with its picture."""
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    with Reader(log) as reader:
        wanted = [c for c in reader.connections if c.topic == "/map"]
        connection, _, raw = next(reader.messages(wanted))
        message: Any = types.deserialize_ros1(raw, connection.msgtype)
    write_occupancy(path, message)
    return path


def write_occupancy(path: Path, message: Any) -> None:
    """A nav_msgs/OccupancyGrid as map_server saves it."""
    info = message.info
    cells = np.array(message.data, np.int8).reshape(info.height, info.width)
    grey = np.full(cells.shape, 205, np.uint8)
    grey[cells == 0], grey[cells == 100] = 254, 0
    header = f"P5\n{info.width} {info.height}\n255\n".encode()
    path.with_suffix(".pgm").write_bytes(header + grey[::-1].tobytes())
    x, y = info.origin.position.x, info.origin.position.y
    path.write_text(
        f"image: {path.stem}.pgm\nresolution: {info.resolution}\norigin: [{x}, {y}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
