"""A coloured mesh of all depth images at their final poses, by a truncated signed distance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.errors import MapError, MissingDependencyError
from mapmyworld.geometry import invert
from mapmyworld.types import CameraModel, Mesh, NodeData, RgbdImage

Array = NDArray[np.float64]
_PACKAGES = "libgl1 libegl1 libx11-6 libgomp1 libusb-1.0-0"


def build_mesh(items: Iterable[tuple[Array, NodeData]], config: Config) -> Mesh:
    """The mesh of all nodes given as (map_from_base (4, 4), data); streams.

    Curless and Levoy, "A volumetric method for building complex models from range images" (1996),
    by Open3D. Raises `MissingDependencyError` where Open3D is absent or cannot load.
    """
    o3d = _open3d()
    settings = config.visual
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_length=settings.mesh_voxel,
        sdf_trunc=settings.mesh_truncation,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8,
    )
    count = 0
    for map_from_base, data in items:
        for image in data.images:
            if image.depth is None:
                continue
            rgbd, intrinsics = _rectified(o3d, image, config)
            pose = map_from_base @ image.camera.base_from_camera
            volume.integrate(rgbd, intrinsics, invert(pose))
            count += 1
    if count == 0:
        raise MapError("no node has a depth image: a mesh needs depth")
    mesh = volume.extract_triangle_mesh()
    colours = np.clip(np.round(np.asarray(mesh.vertex_colors) * 255.0), 0, 255)
    return Mesh(
        np.asarray(mesh.vertices, np.float32),
        np.asarray(mesh.triangles, np.int32),
        colours.astype(np.uint8),
    )


def _open3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"meshes need Open3D, which does not load ({error}): install mapmyworld[mesh] "
            f"and the system packages {_PACKAGES}"
        ) from error
    return open3d


def _rectified(o3d: Any, image: RgbdImage, config: Config) -> tuple[Any, Any]:
    """Open3D's image pair, free of distortion, at the depth image's size, and its intrinsics."""
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
    if camera.distortion_model and np.any(camera.distortion):
        maps = _undistortion(camera, k, width, height)
        colour = cv2.remap(colour, *maps, cv2.INTER_LINEAR)
        depth = cv2.remap(depth, *maps, cv2.INTER_NEAREST)
    rgbd = o3d.geometry.RGBDImage.create_from_color_and_depth(
        o3d.geometry.Image(np.ascontiguousarray(colour)),
        o3d.geometry.Image(np.ascontiguousarray(depth)),
        depth_scale=1.0,
        depth_trunc=config.visual.cloud_range,
        convert_rgb_to_intensity=False,
    )
    return rgbd, o3d.camera.PinholeCameraIntrinsic(
        width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    )


def _undistortion(
    camera: CameraModel, k: Array, width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if camera.distortion_model == "equidistant":
        maps = cv2.fisheye.initUndistortRectifyMap(
            k, camera.distortion[:4], np.eye(3), k, (width, height), cv2.CV_32FC1
        )
    else:
        maps = cv2.initUndistortRectifyMap(
            k, camera.distortion, np.eye(3), k, (width, height), cv2.CV_32FC1
        )
    return maps[0], maps[1]
