"""Triangle meshes as binary PLY, both ways."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from formats.cloud_files import cloud_table
from formats.ply import colours, parse_header, ply_header, positions, read_vertices, read_whole
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


def read_mesh(path: Path) -> Mesh:
    """The mesh of a binary PLY file whose faces are all triangles.

    Raises `MapError` where it is none.
    """
    vertices = read_vertices(path)
    data = read_whole(path)
    head = parse_header(data, path)
    start = head.start + vertices.nbytes
    if head.text_format or len(data) - start < head.face_count * _FACE.itemsize:
        raise MapError(f"{path}: not a binary mesh of triangles, or cut short")
    faces = np.frombuffer(data, _FACE, head.face_count, start)
    if (faces["count"] != 3).any():
        raise MapError(f"{path}: has faces that are no triangles")
    if not 0 <= faces["corners"].min(initial=0) <= faces["corners"].max(initial=0) < len(vertices):
        raise MapError(f"{path}: has triangles of vertices that do not exist")
    points = positions(vertices, path)
    if len(faces) == 0 or not np.isfinite(points).all():
        raise MapError(f"{path}: holds no triangles, or corners that lie nowhere")
    return Mesh(points, faces["corners"].copy(), colours(vertices))
