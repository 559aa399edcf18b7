"""Point clouds as binary PLY or PCD, both ways; meshes as PLY, which `scene_mesh.py` reads."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.ply import colours, ply_header, positions, read_vertices
from formats.whole_files import read_whole, write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import Mesh, PointCloud

_PCD_SIZES = {"F": {4: "<f4", 8: "<f8"}, "U": {1: "u1", 2: "<u2", 4: "<u4"}, "I": {4: "<i4"}}


def write_cloud(path: Path, cloud: PointCloud) -> None:
    """A .ply or .pcd file, by its name; raises `MapError` for another name."""
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        write_whole(path, _pcd(cloud))
    elif suffix == ".ply":
        table = cloud_table(cloud)
        write_whole(path, ply_header(table) + table.tobytes())
    else:
        raise MapError(f"{path}: a cloud is written as .ply or .pcd")


def read_cloud(path: Path) -> PointCloud:
    """The points of a .ply or .pcd file, those that lie nowhere left out, and colours of a .ply."""
    fields = _read_pcd(path) if path.suffix.lower() == ".pcd" else read_vertices(path)
    points = positions(fields, path)
    found = np.isfinite(points).all(axis=1)  # a point without a return is stored as NaN by many
    return PointCloud(points[found], colours(fields[found]))


def cloud_table(cloud: PointCloud, *, packed_colour: bool = False) -> NDArray[np.void]:
    """One record (N,) a point."""
    points = np.asarray(cloud.points, np.float32).reshape(-1, 3)
    columns: list[tuple[str, str, NDArray[np.generic]]] = [
        (name, "<f4", points[:, i]) for i, name in enumerate("xyz")
    ]
    if cloud.normals is not None:
        names = ("normal_x", "normal_y", "normal_z") if packed_colour else ("nx", "ny", "nz")
        columns += [(name, "<f4", cloud.normals[:, i]) for i, name in enumerate(names)]
    if cloud.colours is not None and packed_colour:
        r, g, b = cloud.colours.astype(np.uint32).T
        columns.append(("rgb", "<u4", r << 16 | g << 8 | b))
    elif cloud.colours is not None:
        names = ("red", "green", "blue")
        columns += [(name, "u1", cloud.colours[:, i]) for i, name in enumerate(names)]
    table = np.zeros(len(points), [(name, dtype) for name, dtype, _ in columns])
    for name, _, values in columns:
        table[name] = values
    return table


def _pcd(cloud: PointCloud) -> bytes:
    table = cloud_table(cloud, packed_colour=True)
    names = table.dtype.names or ()
    kinds = [table.dtype[name] for name in names]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(names),
        "SIZE " + " ".join(str(kind.itemsize) for kind in kinds),
        "TYPE " + " ".join("F" if kind.kind == "f" else "U" for kind in kinds),
        "COUNT " + " ".join("1" for _ in names),
        f"WIDTH {len(table)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(table)}",
        "DATA binary",
    ]
    return "".join(f"{line}\n" for line in head).encode() + table.tobytes()


def _read_pcd(path: Path) -> NDArray[np.void]:
    data = read_whole(path)
    end = re.search(rb"^DATA (\S+)\s*\n", data, re.MULTILINE)
    if end is None or end.group(1) != b"binary":
        raise MapError(f"{path}: not a binary PCD file")
    lines = [line.split() for line in data[: end.start()].decode("ascii", "replace").splitlines()]
    head = {words[0]: words[1:] for words in lines if words}
    try:
        sizes, count = [int(size) for size in head["SIZE"]], int(head["POINTS"][0])
        kinds = [_PCD_SIZES[t][s] for t, s in zip(head["TYPE"], sizes, strict=True)]
        dtype = np.dtype(list(zip(head["FIELDS"], kinds, strict=True)))
        return np.frombuffer(data, dtype, count, end.end())
    except (KeyError, IndexError, ValueError, OverflowError) as error:
        raise MapError(f"{path}: a damaged PCD file ({error})") from None


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
    head = ply_header(vertices, len(faces))
    write_whole(path, head + vertices.tobytes() + faces.tobytes())
