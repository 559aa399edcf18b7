"""Which sensors a map keeps, as the first nodes of each of its sessions show."""

from __future__ import annotations

import numpy as np

from mapmyworld.types import MapStore, first_nodes


def has_images(store: MapStore) -> bool:
    """Whether nodes keep images with depth."""
    nodes = first_nodes(store.nodes())
    return any(store.node_data(node.id, features=False).images for node in nodes)


def has_scans(store: MapStore) -> bool:
    """Whether tracked frames keep scans."""
    looked_at = np.array([node.id for node in first_nodes(store.nodes())], np.int64)
    frames = np.flatnonzero(np.isin(store.tracked_frames().node_ids, looked_at))
    return next(iter(store.scans(frames)), None) is not None
