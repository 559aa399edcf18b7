"""PLY files: headers, and the vertices of binary little-endian and ASCII ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.whole_files import read_whole
from mapmyworld.errors import MapError

_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2",
    "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4",
    "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
_MAX_HEADER = 1 << 16


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """What a PLY file says that it holds."""

    text_format: bool
    vertex_count: int
    vertex_type: np.dtype[np.void]
    start: int
    """Byte at which the vertices begin."""


def ply_header(vertices: NDArray[np.void], faces: int = 0) -> bytes:
    """The header of binary vertices (N,), a record array, and of so many faces."""
    lines = ["ply", "format binary_little_endian 1.0", "comment mapmyworld, metres, map frame"]
    lines.append(f"element vertex {len(vertices)}")
    kinds = {name: vertices.dtype[name].str.lstrip("<|") for name in vertices.dtype.names or ()}
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "".join(f"{line}\n" for line in [*lines, "end_header"]).encode()


def read_vertices(path: Path) -> NDArray[np.void]:
    """The vertices (N,), as a record array with the file's own property names.

    Raises `MapError` where the file ends early.
    """
    data = read_whole(path)
    head = _parse_header(data, path)
    try:
        if head.text_format:
            return _text_vertices(data, head)
        return np.frombuffer(data, head.vertex_type, head.vertex_count, head.start)
    except FloatingPointError:
        raise MapError(f"{path}: holds a number that its type cannot hold") from None
    except (ValueError, OverflowError):
        raise MapError(f"{path}: ends before its {head.vertex_count} vertices") from None


def _text_vertices(data: bytes, head: PlyHeader) -> NDArray[np.void]:
    lines = data[head.start :].decode("ascii", "replace").splitlines()[: head.vertex_count]
    rows = [tuple(float(word) for word in line.split()) for line in lines]
    if len(rows) < head.vertex_count:
        raise ValueError("too few lines")
    table = np.array(rows, [(n, "<f8") for n in head.vertex_type.names or ()])
    with np.errstate(invalid="raise", over="raise"):
        return table.astype(head.vertex_type)


def positions(vertices: NDArray[np.void], path: Path) -> NDArray[np.float32]:
    """(N, 3) of the vertices (N,), metres; infinite where single precision cannot hold them.

    Raises `MapError` where they have no x, y, z.
    """
    if not set("xyz") <= set(vertices.dtype.names or ()):
        raise MapError(f"{path}: its points have no x, y, z")
    with np.errstate(over="ignore", invalid="ignore"):
        return np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float32)


def colours(vertices: NDArray[np.void]) -> NDArray[np.uint8] | None:
    """(N, 3) red, green, blue of the vertices (N,), if they have colours."""
    names = ("red", "green", "blue")
    if not set(names) <= set(vertices.dtype.names or ()):
        return None
    values = np.column_stack([vertices[name] for name in names])
    return np.asarray(np.nan_to_num(values).clip(0, 255), np.uint8)


def _parse_header(data: bytes, path: Path) -> PlyHeader:
    """The header of a file whose first element is the vertices; MapError for any other."""
    end = data.find(b"end_header", 0, _MAX_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise MapError(f"{path}: not a PLY file")
    start = data.index(b"\n", end) + 1 if b"\n" in data[end : end + 14] else len(data)
    lines = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    try:
        return _parse_lines([words for words in lines if words], start)
    except (KeyError, IndexError, ValueError) as error:
        raise MapError(f"{path}: a PLY header that cannot be read ({error})") from None


def _parse_lines(lines: list[list[str]], start: int) -> PlyHeader:
    fields: dict[str, list[tuple[str, str]]] = {}
    counts: dict[str, int] = {}
    element, kind = "", ""
    for words in lines:
        if words[0] == "format":
            kind = words[1]
        elif words[0] == "element":
            element = words[1]
            counts[element], fields[element] = int(words[2]), []
        elif words[0] == "property" and words[1] != "list":
            fields[element].append((words[2], _TYPES[words[1]]))
    if kind not in ("ascii", "binary_little_endian"):
        raise ValueError(f"format {kind!r}")
    if next(iter(counts), "") != "vertex" or min(counts.values()) < 0:
        raise ValueError("the first element is not the vertices, or one has fewer than none")
    dtype = np.dtype(fields["vertex"])
    return PlyHeader(kind == "ascii", counts["vertex"], dtype, start)
