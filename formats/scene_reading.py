"""Open3D's reading of a mesh, in a process of its own: a damaged file can bring that one down."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

NOT_THERE = 3
"""Exit code where Open3D does not load; the output says why."""
_GREY = 180  # of meshes without colours


def give_mesh(path: str) -> None:
    """Writes vertices, triangles and colours as .npz to the output; Open3D's own words nowhere."""
    output = os.dup(1)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    with open(output, "wb") as stream:
        try:
            import open3d
        except (ImportError, OSError) as error:
            stream.write(str(error).encode())
            sys.exit(NOT_THERE)
        packed = io.BytesIO()
        vertices, triangles, colours = arrays_of_mesh(open3d, Path(path))
        np.savez(packed, vertices=vertices, triangles=triangles, colours=colours)
        stream.write(packed.getbuffer())


def arrays_of_mesh(
    open3d: Any, path: Path
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8]]:
    """Vertices (V, 3), triangles (T, 3) and colours (V, 3) as the file has them, unchecked."""
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        mesh = open3d.io.read_triangle_mesh(str(path), enable_post_processing=False)
    vertices = np.asarray(mesh.vertices, np.float64)
    triangles = np.asarray(mesh.triangles, np.int32)
    return vertices, triangles, _colours(mesh, len(vertices), triangles)


def _colours(mesh: Any, count: int, triangles: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(V, 3) from the vertices' own colours or the texture under them, else grey."""
    if mesh.has_vertex_colors():
        shares = np.nan_to_num(np.asarray(mesh.vertex_colors))
        return np.asarray(np.round(shares.clip(0.0, 1.0) * 255.0), np.uint8)
    colours = np.full((count, 3), _GREY, np.uint8)
    if not mesh.has_triangle_uvs():
        return colours
    material = np.asarray(mesh.triangle_material_ids)
    uv = np.nan_to_num(np.asarray(mesh.triangle_uvs), posinf=0.0, neginf=0.0).reshape(-1, 3, 2)
    for number, texture in enumerate(mesh.textures):
        picture, painted = np.asarray(texture), np.flatnonzero(material == number)
        if picture.ndim == 3 and len(painted):
            colours[triangles[painted]] = _sampled(picture, uv[painted])
    return colours


def _sampled(picture: NDArray[np.uint8], uv: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours (..., 3) of a texture (H, W, C) at `uv` (..., 2), which repeats; v points up."""
    column = ((uv[..., 0] % 1.0) * (picture.shape[1] - 1)).astype(int)
    row = ((1.0 - uv[..., 1] % 1.0) * (picture.shape[0] - 1)).astype(int)
    return np.asarray(picture[row, column, :3])
