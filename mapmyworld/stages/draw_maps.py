"""The stage that draws the grid, from the store alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.decisions import decided
from mapmyworld.errors import NothingToDrawError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.parallel import in_threads, on_one_thread
from mapmyworld.stages.kept import has_images, has_scans
from mapmyworld.types import MapStore, Poses, Progress, Scan

Placed = tuple[NDArray[np.float64], Scan]
"""A pose (3,) in the plane, and the scan that was taken there."""


@on_one_thread
def draw_maps(store: MapStore, config: Config, progress: Progress) -> None:
    """The occupancy grid of all scans at their final poses; of depth where there is no laser."""
    if has_scans(store):
        frames = store.frame_poses()
        assert frames is not None
        progress.stage("grid", len(frames), "scans")
        scans = scans_at(store, np.arange(len(frames)), frames)
        _draw(scans, frames, store, config, progress)
    elif has_images(store):
        poses = store.poses()
        assert poses is not None
        progress.stage("grid from depth", len(store.nodes()), "nodes")
        try:
            scans = depth_scans(store, poses, config)
            _draw(scans, poses.map_from_node, store, config, progress)
        except NothingToDrawError as nothing:  # neither floor nor anything in the way was seen
            progress.note(f"no grid from depth: {nothing}")


def _draw(
    scans: Iterator[Placed],
    poses: NDArray[np.float64],
    store: MapStore,
    config: Config,
    progress: Progress,
) -> None:
    """The grid of scans, which were taken at poses (N, 4, 4) or near them."""
    from mapmyworld.mapping.occupancy import build_grid

    grid = build_grid(_counted(scans, progress), config, poses[:, :2, 3])
    store.set_grid(grid)
    rows, columns = grid.log_odds.shape
    decided("map", f"{columns} x {rows} cells of {grid.resolution:g} m")


def _counted(scans: Iterator[Placed], progress: Progress) -> Iterator[Placed]:
    for done, scan in enumerate(scans):
        yield scan
        progress.update(done)


def scans_at(
    store: MapStore, frames: NDArray[np.int64], map_from_frame: NDArray[np.float64]
) -> Iterator[Placed]:
    """The scans of those frames (K,) that have one, each with its pose (3,), of poses (K, 4, 4)."""
    place = dict(zip(frames.tolist(), matrix_to_planar(map_from_frame), strict=True))
    return ((place[frame], scan) for frame, scan in store.scans(frames))


def depth_scans(store: MapStore, poses: Poses, config: Config) -> Iterator[Placed]:
    """Scans made from the depth images of all nodes, each with its pose (3,)."""
    from mapmyworld.mapping.depth_grid import planar_scan

    items = (
        (image, pose)
        for node_id, pose in zip(poses.ids, poses.map_from_node, strict=True)
        if node_id > 0
        for image in store.node_data(int(node_id), features=False).images
        if image.depth is not None
    )
    return in_threads(lambda item: planar_scan(*item, config), items, config.threads)
