"""Triangle meshes written as binary PLY; `formats/scene_mesh.py` reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from formats.cloud_files import cloud_table
from formats.ply import ply_header
from formats.whole_files import write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import Mesh, PointCloud

_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_mesh(path: Path, mesh: Mesh) -> None:
    """A .ply file of vertices, with colours where there are any, and triangles.

    Raises `MapError` for another name.
    """
    if path.suffix.lower() != ".ply":
        raise MapError(f"{path}: a mesh is written as .ply: give a name that ends in .ply")
    vertices = cloud_table(PointCloud(mesh.vertices, mesh.colours))
    faces = np.empty(len(mesh.triangles), _FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    head = ply_header([("vertex", vertices)], len(faces))
    write_whole(path, head + vertices.tobytes() + faces.tobytes())
