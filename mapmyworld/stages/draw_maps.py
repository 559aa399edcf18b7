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
from mapmyworld.types import MapStore, Progress, Scan


@on_one_thread
def draw_maps(store: MapStore, config: Config, progress: Progress) -> None:
    """The occupancy grid of all scans at their final poses; of depth where there is no laser."""
    from mapmyworld.mapping.occupancy import build_grid

    if has_scans(store):
        frames = store.frame_poses()
        assert frames is not None
        progress.stage("grid", len(frames), "scans")
        store.set_grid(build_grid(_scans(store, frames, progress), config))
    elif has_images(store):
        progress.stage("grid from depth", len(store.nodes()), "nodes")
        try:
            store.set_grid(build_grid(_depth_scans(store, config, progress), config))
        except NothingToDrawError as nothing:  # neither floor nor anything in the way was seen
            progress.note(f"no grid from depth: {nothing}")
    if (grid := store.grid()) is not None:
        rows, columns = grid.log_odds.shape
        decided("map", f"{columns} x {rows} cells of {grid.resolution:g} m")


def _scans(
    store: MapStore, map_from_frame: NDArray[np.float64], progress: Progress
) -> Iterator[tuple[NDArray[np.float64], Scan]]:
    planar = matrix_to_planar(map_from_frame)
    for frame, scan in store.scans(np.arange(len(planar))):
        yield planar[frame], scan
        progress.update(frame)


def _depth_scans(
    store: MapStore, config: Config, progress: Progress
) -> Iterator[tuple[NDArray[np.float64], Scan]]:
    from mapmyworld.mapping.depth_grid import planar_scan

    poses = store.poses()
    assert poses is not None
    items = (
        (image, pose)
        for node_id, pose in zip(poses.ids, poses.map_from_node, strict=True)
        if node_id > 0
        for image in store.node_data(int(node_id), features=False).images
        if image.depth is not None
    )

    drawn = in_threads(lambda item: planar_scan(*item, config), items, config.threads)
    for done, found in enumerate(drawn):
        yield found
        progress.update(done)
