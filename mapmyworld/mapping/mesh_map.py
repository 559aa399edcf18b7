"""A coloured mesh of all depth images at their final poses, by a truncated signed distance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert
from mapmyworld.open3d_library import import_open3d
from mapmyworld.registration.camera_model import is_distorted, opencv_model
from mapmyworld.types import Mesh, NodeData, RgbdImage

_TRUNCATION = 4.0  # voxels on either side of a surface that a view informs about
_VIEWS = 2.0  # measurements that a voxel of the mesh needs
_BLOCK = 16  # voxels along the edge of a block
_FIRST_BLOCKS = 2000  # room at the start; the volume grows


def build_mesh(items: Iterable[tuple[Array, NodeData]], config: Config) -> Mesh:
    """The mesh of all nodes given as (map_from_base (4, 4), data); streams.

    Curless and Levoy, "A volumetric method for building complex models from range images" (1996),
    by Open3D. Raises `MissingDependencyError` where Open3D is absent or cannot load. Raises
    `MapError` where no node has a depth image.
    """
    o3d = import_open3d("a mesh")
    core, settings = o3d.core, config.visual
    single, triple = core.SizeVector([1]), core.SizeVector([3])
    # The tensor volume: Open3D 0.20's older one integrates nothing.
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"),
        (core.float32, core.float32, core.float32),
        (single, single, triple),
        settings.mesh_voxel,
        _BLOCK,
        _FIRST_BLOCKS,
    )
    count = 0
    for map_from_base, data in items:
        for image in data.images:
            if image.depth is None:
                continue
            _integrate(o3d, volume, image, map_from_base, settings.cloud_range)
            count += 1
    if count == 0:
        raise MapError("no node has a depth image: a mesh needs depth")
    mesh = volume.extract_triangle_mesh(_VIEWS)
    colours = np.clip(np.round(mesh.vertex.colors.numpy()), 0, 255)
    return Mesh(
        mesh.vertex.positions.numpy().astype(np.float32),
        mesh.triangle.indices.numpy().astype(np.int32),
        colours.astype(np.uint8),
    )


def _integrate(
    o3d: Any, volume: Any, image: RgbdImage, map_from_base: Array, farthest: float
) -> None:
    colour, depth, k = _rectified(image)
    tensor, picture = o3d.core.Tensor, o3d.t.geometry.Image
    map_from_camera = map_from_base @ image.camera.base_from_camera
    intrinsics, extrinsics = tensor(k), tensor(invert(map_from_camera))
    pictured = picture(tensor(np.ascontiguousarray(depth)))
    coloured = picture(tensor(np.ascontiguousarray(colour, np.float32)))
    scale_and_range = (1.0, farthest, _TRUNCATION)
    blocks = volume.compute_unique_block_coordinates(
        pictured, intrinsics, extrinsics, *scale_and_range
    )
    if len(blocks):
        volume.integrate(
            blocks, pictured, coloured, intrinsics, intrinsics, extrinsics, *scale_and_range
        )


def _rectified(image: RgbdImage) -> tuple[NDArray[np.uint8], NDArray[np.float32], Array]:
    """Colour and depth free of distortion, at the depth image's size, and their intrinsics."""
    assert image.depth is not None
    depth = np.asarray(image.depth.pixels(), np.float32)
    height, width = depth.shape
    camera = image.camera
    k = camera.intrinsics.copy()
    k[:2] *= width / camera.width
    k[:2, 2] += 0.5 * (width / camera.width - 1.0)
    if image.colour is None:
        colour = np.full((height, width, 3), 128, np.uint8)
    else:
        colour = np.asarray(image.colour.pixels(), np.uint8)
        if colour.ndim == 2:
            colour = np.repeat(colour[..., None], 3, axis=2)
        if colour.shape[:2] != depth.shape:
            colour = np.asarray(cv2.resize(colour, (width, height), interpolation=cv2.INTER_AREA))
    if is_distorted(camera):
        model, distortion = opencv_model(camera)
        maps = model.initUndistortRectifyMap(
            k, distortion, np.eye(3), k, (width, height), cv2.CV_32FC1
        )
        colour = cv2.remap(colour, *maps, cv2.INTER_LINEAR)
        depth = cv2.remap(depth, *maps, cv2.INTER_NEAREST)
    return colour, depth, k
