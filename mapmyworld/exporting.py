"""From a stored map to files: what `export` and the end of `build` share."""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.types import (
    MapStore,
    Node,
    NodeData,
    OccupancyGrid,
    PointCloud,
    Poses,
    Scan,
    Trajectory,
    first_nodes,
)

if TYPE_CHECKING:
    from mapmyworld.config import Config
    from mapmyworld.types.pose_graph import PoseGraph


def export_beside(store: MapStore, map_path: Path, config: Config) -> list[str]:
    """Writes grid, trajectory and cloud of a finished map beside its database."""
    written = export_grid(store, map_path.with_suffix(""))
    written += export_trajectory(store, map_path.with_suffix(".tum"))
    written += export_cloud(store, map_path.with_suffix(".ply"), config)
    return [str(path) for path in written]


def export_grid(store: MapStore, stem: Path) -> list[Path]:
    """Writes the stored grid; nothing where there is none."""
    from formats.grid_files import write_grid

    grid = store.grid()
    return [] if grid is None else list(write_grid(stem, grid))


def export_trajectory(
    store: MapStore,
    path: Path,
    style: Any = "tum",
    which: Literal["optimised", "odometry"] = "optimised",
) -> list[Path]:
    """Writes the pose of every tracked frame, or of every node where only those were kept."""
    from formats.trajectory_files import write_trajectory

    write_trajectory(path, trajectory_of(store, which), style)
    return [path]


def export_cloud(store: MapStore, path: Path, config: Config) -> list[Path]:
    """Writes the cloud of depth images or 3D scans; nothing where there are none."""
    from formats.cloud_files import write_cloud

    cloud = cloud_of(store, config)
    if cloud is None:
        return []
    write_cloud(path, cloud)
    return [path]


def cloud_of(store: MapStore, config: Config) -> PointCloud | None:
    """The cloud of depth images or 3D scans; None where there are none."""
    kept = [store.node_data(node.id, features=False) for node in first_nodes(store.nodes())]
    if not any(data.cloud is not None or _depth_of(data) for data in kept):
        return None
    from mapmyworld.geometry.rigid import evenly_along
    from mapmyworld.mapping.cloud_map import build_cloud

    thinned = None
    if not any(_depth_of(data) for data in kept):
        # Voxels half as large as the points' spacing: finer ones hold one point each, and a drive's
        # lidar fills more of them than there is memory.
        voxel = max(config.visual.cloud_voxel, 0.5 * config.sensing.cloud_spacing)
        config = _counting_each_point(config)
        config = replace(config, visual=replace(config.visual, cloud_voxel=voxel))
    if not any(data.cloud is not None for data in kept):
        poses = solved_poses(store)
        nodes = np.flatnonzero(poses.ids > 0)
        # Neighbours see nearly the same.
        chosen = evenly_along(poses.map_from_node[nodes], config.visual.cloud_spacing)
        thinned = set(poses.ids[nodes[chosen]].tolist())
    return build_cloud(nodes_with_poses(store, thinned), config)


def export_scan_cloud(store: MapStore, path: Path, config: Config) -> list[Path]:
    """Writes the returns of all planar scans, at height 0, one a voxel."""
    from formats.cloud_files import write_cloud
    from mapmyworld.mapping.cloud_map import build_cloud

    flat = ((pose, NodeData(cloud=_lifted(data.scan))) for pose, data in nodes_with_poses(store))
    write_cloud(path, build_cloud(flat, _counting_each_point(config)))
    return [path]


def _counting_each_point(config: Config) -> Config:
    """Lidars see a voxel seldom, and are believed at once."""
    return replace(config, visual=replace(config.visual, cloud_views=1))


def _lifted(scan: Scan | None) -> NDArray[np.float32] | None:
    if scan is None:
        return None
    return np.column_stack([scan.points, np.zeros(len(scan.points), np.float32)])


def _depth_of(data: NodeData) -> bool:
    return any(image.depth is not None for image in data.images)


_FLAT = 1e-3  # m, rad


def trajectory_of(store: MapStore, which: str = "optimised") -> Trajectory:
    """Poses of all tracked frames in time: final ones, or the recorded odometry.

    Odometry of the nodes alone where that of the frames was not kept.
    """
    if which == "odometry":
        recorded = store.tracked_frames()
        if recorded.odom_from_base is not None:
            return Trajectory(recorded.stamps_ns, recorded.odom_from_base)
        nodes = store.nodes()
        _require(bool(nodes), store, "holds no nodes")
        stamps = np.array([node.stamp_ns for node in nodes], np.int64)
        return Trajectory(stamps, np.stack([node.odom_from_base for node in nodes]))
    frames = store.tracked_frames()
    which_frames, poses = frame_poses(store)
    return Trajectory(frames.stamps_ns[which_frames], poses)


def frame_poses(store: MapStore) -> tuple[NDArray[np.int64], Array]:
    """Indices (K,) of tracked frames that have a place in the map, and map_from_frame (K, 4, 4)."""
    stored = store.frame_poses()
    if stored is not None:
        return np.arange(len(stored)), stored
    poses, frames = solved_poses(store), store.tracked_frames()
    place = {int(node_id): i for i, node_id in enumerate(poses.ids)}
    rows = np.array([place.get(int(node_id), -1) for node_id in frames.node_ids], np.int64)
    known = np.flatnonzero(rows >= 0)
    return known, poses.map_from_node[rows[known]] @ frames.node_from_frame[known]


def solved_poses(store: MapStore) -> Poses:
    """The optimised poses; computed here where the file was left without them."""
    poses = store.poses()
    if poses is not None:
        return poses
    from mapmyworld.config import GraphConfig
    from mapmyworld.geometry.planar import planar_to_matrix
    from mapmyworld.graph.canonical_graph import graph_from_constraints
    from mapmyworld.graph.optimisation import optimise

    nodes, constraints = store.nodes(), store.constraints()
    _require(bool(nodes), store, "holds no nodes")
    ids, start = np.array([n.id for n in nodes]), np.stack([n.odom_from_base for n in nodes])
    planar = is_planar(start)
    graph = graph_from_constraints(ids, start, constraints, planar)
    solved = optimise(graph, GraphConfig()).graph
    placed = planar_to_matrix(solved.map_from_node) if planar else solved.map_from_node
    return Poses(solved.ids, placed)


def nodes_with_poses(
    store: MapStore, chosen: Container[int] | None = None
) -> Iterator[tuple[Array, NodeData]]:
    """map_from_base (4, 4) and data of every node in the map, in time; or of the chosen ones."""
    poses = solved_poses(store)
    place = {int(node_id): i for i, node_id in enumerate(poses.ids)}
    for node in store.nodes():
        if node.id in place and (chosen is None or node.id in chosen):
            data = store.node_data(node.id, features=False)
            yield poses.map_from_node[place[node.id]], data


def node_items(store: MapStore) -> Iterator[tuple[Node, NodeData, Array]]:
    """Every node with its data and map_from_base (4, 4), by odometry where it has none."""
    poses = store.poses()
    place = {} if poses is None else dict(zip(poses.ids.tolist(), poses.map_from_node, strict=True))
    for node in store.nodes():
        yield node, store.node_data(node.id), place.get(node.id, node.odom_from_base)


def graph_of(store: MapStore) -> PoseGraph:
    """The solved graph: accepted constraints with the covariances that the solution found."""
    from mapmyworld.graph.canonical_graph import graph_from_constraints
    from mapmyworld.map_figures import calibrated_constraints

    poses, constraints = solved_poses(store), calibrated_constraints(store)
    planar = is_planar(poses.map_from_node)
    return graph_from_constraints(poses.ids, poses.map_from_node, constraints, planar)


def is_planar(poses: Array) -> bool:
    """Whether poses (N, 4, 4) stay in the plane z = 0."""
    return bool(np.abs(poses[:, 2, 3]).max() < _FLAT and np.abs(poses[:, 2, :2]).max() < _FLAT)


def grid_at(store: MapStore, config: Config, resolution: float | None) -> OccupancyGrid:
    """The stored grid, or one made anew from the scans where another resolution is wanted."""
    grid = store.grid()
    if grid is not None and resolution in (None, grid.resolution):
        return grid
    from mapmyworld.mapping.occupancy import build_grid

    if resolution is not None:
        config = replace(config, mapping=replace(config.mapping, resolution=resolution))
    frames, poses = frame_poses(store)
    return build_grid(_planar_scans(store, frames, poses, config), config, poses[:, :2, 3])


def _planar_scans(
    store: MapStore, frames: NDArray[np.int64], map_from_frame: Array, config: Config
) -> Iterator[tuple[Array, Scan]]:
    """The scans of those frames (K,) at their poses (K, 4, 4); from depth where is no laser."""
    from mapmyworld.stages.draw_maps import depth_scans, scans_at

    found = False
    for scan in scans_at(store, frames, map_from_frame):
        found = True
        yield scan
    if not found:
        for scan in depth_scans(store, solved_poses(store), config):
            found = True
            yield scan
    _require(found, store, "keeps neither scans nor depth to make a grid of")


def _require(there: bool, store: MapStore, otherwise: str) -> None:
    if not there:
        raise MapError(f"{getattr(store, 'path', 'the map')}: {otherwise}")
