"""A map's path and cloud as plain arrays, and as what evo and Open3D take: one call each."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapmyworld.api import AnyMap, opened
from mapmyworld.config import Config
from mapmyworld.errors import MapError, MissingDependencyError
from mapmyworld.exporting import cloud_of, trajectory_of
from mapmyworld.geometry.rotations import rotation_to_quaternion
from mapmyworld.open3d_library import import_open3d
from mapmyworld.types import PointCloud, Trajectory


def trajectory(finished: AnyMap) -> Trajectory:
    """The pose of every tracked frame of a map, in time."""
    with opened(finished) as store:
        return trajectory_of(store)


def cloud(finished: AnyMap, *, config: Config | None = None) -> PointCloud:
    """The coloured cloud of a map's depth images or 3D scans; `MapError` where it keeps none."""
    with opened(finished) as store:
        made = cloud_of(store, config or Config())
    if made is None:
        raise MapError("the map keeps neither depth images nor 3D scans to make a cloud of")
    return made


def to_arrays(finished: AnyMap) -> dict[str, Any]:
    """A map as plain numpy arrays: path, nodes, constraints and grid, by name.

    stamps_ns (F,), map_from_base (F, 4, 4); node_ids (N,), map_from_node (N, 4, 4), covariances
    (N, 6, 6) rotation first or None; edges (E, 2) from and to, accepted (E,), kinds (E,); grid
    (H, W) 100 occupied, 0 free, -1 unknown, or None, its resolution (m) and origin (2,).
    """
    with opened(finished) as store:
        path, poses, grid = trajectory_of(store), store.poses(), store.grid()
        constraints = store.constraints()
    return {
        "stamps_ns": path.stamps_ns,
        "map_from_base": path.poses,
        "node_ids": None if poses is None else poses.ids,
        "map_from_node": None if poses is None else poses.map_from_node,
        "covariances": None if poses is None else poses.covariances,
        "edges": np.array([(c.from_id, c.to_id) for c in constraints], np.int64).reshape(-1, 2),
        "accepted": np.array([c.accepted for c in constraints], np.bool_),
        "kinds": np.array([str(c.kind) for c in constraints]),
        "grid": None if grid is None else grid.trinary(),
        "resolution": None if grid is None else grid.resolution,
        "origin": None if grid is None else grid.origin,
    }


def to_evo(path: AnyMap | Trajectory) -> Any:
    """Evo's `PoseTrajectory3D` of a map or a trajectory.

    Raises `MissingDependencyError` where evo is not installed.
    """
    try:
        from evo.core.trajectory import PoseTrajectory3D
    except ImportError:
        raise MissingDependencyError("evo is not installed: `pip install evo`") from None
    found = path if isinstance(path, Trajectory) else trajectory(path)
    x, y, z, w = rotation_to_quaternion(found.poses[:, :3, :3]).T
    return PoseTrajectory3D(
        positions_xyz=found.poses[:, :3, 3],
        orientations_quat_wxyz=np.stack([w, x, y, z], axis=1),
        timestamps=found.stamps_ns * 1e-9,
    )


def to_open3d(points: AnyMap | PointCloud) -> Any:
    """Open3D's `geometry.PointCloud` of a map or a cloud, with its colours and normals."""
    found = points if isinstance(points, PointCloud) else cloud(points)
    o3d = import_open3d("a cloud of Open3D's")
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(found.points.astype(np.float64)))
    if found.colours is not None:
        made.colors = o3d.utility.Vector3dVector(found.colours / 255.0)
    if found.normals is not None:
        made.normals = o3d.utility.Vector3dVector(found.normals.astype(np.float64))
    return made
