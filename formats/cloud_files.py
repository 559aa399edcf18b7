"""Point clouds as binary PLY or PCD, both ways; meshes as PLY, which `scene_mesh.py` reads."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.whole_files import read_whole, write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import Mesh, PointCloud

_COLOURS = ("red", "green", "blue")
_PCD_SIZES = {"F": {4: "<f4", 8: "<f8"}, "U": {1: "u1", 2: "<u2", 4: "<u4"}, "I": {4: "<i4"}}
_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2",
    "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4",
    "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
_MAX_HEADER = 1 << 16


def write_cloud(path: Path, cloud: PointCloud) -> None:
    """A .ply or .pcd file, by its name; raises `MapError` for another name."""
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        write_whole(path, _pcd(cloud))
    elif suffix == ".ply":
        table = cloud_table(cloud)
        write_whole(path, _ply_header(table) + table.tobytes())
    else:
        raise MapError(f"{path}: a cloud is written as .ply or .pcd")


def read_cloud(path: Path) -> PointCloud:
    """The points of a .ply or .pcd file, those that lie nowhere left out, and colours of a .ply.

    Raises `MapError` where it is damaged, or holds none.
    """
    fields = _read_pcd(path) if path.suffix.lower() == ".pcd" else _read_ply(path)
    names = set(fields.dtype.names or ())
    if not set("xyz") <= names:
        raise MapError(f"{path}: its points have no x, y, z")
    with np.errstate(over="ignore", invalid="ignore"):  # infinite beyond single precision
        points = np.column_stack([fields[axis] for axis in "xyz"]).astype(np.float32)
    found = np.isfinite(points).all(axis=1)  # a point without a return is stored as NaN by many
    colours = None
    if names.issuperset(_COLOURS):
        values = np.column_stack([fields[found][name] for name in _COLOURS])
        colours = np.asarray(np.nan_to_num(values).clip(0, 255), np.uint8)
    return PointCloud(points[found], colours)


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
        columns += [(name, "u1", cloud.colours[:, i]) for i, name in enumerate(_COLOURS)]
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


def _ply_header(vertices: NDArray[np.void], faces: int = 0) -> bytes:
    """The header of binary vertices (N,), a record array, and of so many faces."""
    lines = ["ply", "format binary_little_endian 1.0", "comment mapmyworld, metres, map frame"]
    lines.append(f"element vertex {len(vertices)}")
    kinds = {name: vertices.dtype[name].str.lstrip("<|") for name in vertices.dtype.names or ()}
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "".join(f"{line}\n" for line in [*lines, "end_header"]).encode()


def _read_ply(path: Path) -> NDArray[np.void]:
    """The vertices (N,), as a record array with the file's own property names."""
    data = read_whole(path)
    is_text, count, kind, start = _parse_header(data, path)
    try:
        if is_text:
            lines = data[start:].decode("ascii", "replace").splitlines()
            rows = [tuple(map(float, line.split())) for line in lines[:count]]
            if len(rows) < count:
                raise ValueError("too few lines")
            table = np.array(rows, [(n, "<f8") for n in kind.names or ()])
            with np.errstate(invalid="raise", over="raise"):
                return table.astype(kind)
        return np.frombuffer(data, kind, count, start)
    except FloatingPointError:
        raise MapError(f"{path}: holds a number that its type cannot hold") from None
    except (ValueError, OverflowError):
        raise MapError(f"{path}: ends before its {count} vertices") from None


def _parse_header(data: bytes, path: Path) -> tuple[bool, int, np.dtype[np.void], int]:
    """Whether the file is text, how many vertices it has, of what type, and where they begin.

    MapError where they are not its first element.
    """
    end = data.find(b"end_header", 0, _MAX_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise MapError(f"{path}: not a PLY file")
    start = data.index(b"\n", end) + 1 if b"\n" in data[end : end + 14] else len(data)
    fields: dict[str, list[tuple[str, str]]] = {}
    counts: dict[str, int] = {}
    element, kind = "", ""
    try:
        for words in map(str.split, data[:end].decode("ascii", "replace").splitlines()):
            if words[:1] == ["format"]:
                kind = words[1]
            elif words[:1] == ["element"]:
                element = words[1]
                counts[element], fields[element] = int(words[2]), []
            elif words[:1] == ["property"] and words[1] != "list":
                fields[element].append((words[2], _TYPES[words[1]]))
        if kind not in ("ascii", "binary_little_endian"):
            raise ValueError(f"format {kind!r}")
        if next(iter(counts), "") != "vertex" or min(counts.values()) < 0:
            raise ValueError("the first element is not the vertices, or one has fewer than none")
        return kind == "ascii", counts["vertex"], np.dtype(fields["vertex"]), start
    except (KeyError, IndexError, ValueError) as error:
        raise MapError(f"{path}: a PLY header that cannot be read ({error})") from None


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
    head = _ply_header(vertices, len(faces))
    write_whole(path, head + vertices.tobytes() + faces.tobytes())
