"""A user's own world: a mesh from PLY, OBJ, GLB and whatever else Open3D reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.scene_claims import check_claims
from mapmyworld.errors import MapError, MissingDependencyError
from mapmyworld.types import Mesh

SCENE_SUFFIXES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off")
_PACKAGES = "libgl1 libegl1 libx11-6 libusb-1.0-0 libgomp1"
_Y_UP = (".glb", ".gltf")  # formats whose standard says that y points up
_GREY = 180  # of meshes without colours


def read_scene_mesh(path: Path) -> Mesh:
    """The mesh with z up and a colour at each vertex, textures sampled; metres are assumed.

    Raises `MapError` where the file is no mesh, `MissingDependencyError` without Open3D.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"reading {path.name} needs Open3D ({error}): `pip install open3d` and, "
            f"on a bare system, `apt-get install {_PACKAGES}`"
        ) from None
    if not path.is_file():
        raise MapError(f"{path}: there is no such file")
    check_claims(path)
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        mesh = open3d.io.read_triangle_mesh(str(path), enable_post_processing=False)
    vertices = np.asarray(mesh.vertices, np.float64)
    triangles = np.asarray(mesh.triangles, np.int32)
    if len(triangles) == 0 or not np.isfinite(vertices).all():
        raise MapError(f"{path}: holds no triangles that could be a world")
    colours = _colours(mesh, len(vertices), triangles)
    if path.suffix.lower() in _Y_UP:
        vertices = vertices @ np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    return Mesh(vertices.astype(np.float32), triangles, colours)


def _colours(mesh: Any, count: int, triangles: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(V, 3) from the vertices' own colours or the texture under them, else grey."""
    if mesh.has_vertex_colors():
        return np.round(np.asarray(mesh.vertex_colors) * 255.0).astype(np.uint8)
    colours = np.full((count, 3), _GREY, np.uint8)
    if not mesh.has_triangle_uvs():
        return colours
    material = np.asarray(mesh.triangle_material_ids)
    uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2)
    for number, texture in enumerate(mesh.textures):
        picture, painted = np.asarray(texture), np.flatnonzero(material == number)
        if picture.ndim == 3 and len(painted):
            colours[triangles[painted]] = _sampled(picture, uv[painted])
    return colours


def _sampled(picture: NDArray[np.uint8], uv: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours (..., 3) of a texture (H, W, C) at `uv` (..., 2), which repeats; v points up."""
    column = ((uv[..., 0] % 1.0) * (picture.shape[1] - 1)).astype(int)
    row = ((1.0 - uv[..., 1] % 1.0) * (picture.shape[0] - 1)).astype(int)
    return picture[row, column, :3]
