"""What a mesh file claims to hold, against what it is: Open3D takes room for a claim unseen."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from formats.nested_text import json_from_text
from mapmyworld.errors import MapError

_GLB = struct.Struct("<4sIIII")  # magic, version, length; then the first chunk's length and kind
_HEAD_BYTES = 1 << 16


def check_claims(path: Path) -> None:
    """Raises `MapError` where the file claims more elements than its bytes could hold.

    And where it names a part or a picture outside its folder.
    """
    suffix, size = path.suffix.lower(), path.stat().st_size
    claimed = 0
    if suffix in (".glb", ".gltf"):
        claimed, size = _claimed_by_gltf(path, size)
    elif suffix == ".ply":
        claimed = _largest(_head(path).partition(b"end_header")[0], b"element")
    elif suffix == ".obj":
        _check_materials(path)
    elif suffix == ".off":
        claimed = max([int(word) for word in _head(path).split()[:4] if word.isdigit()], default=0)
    if claimed > size:
        raise MapError(f"{path}: claims {claimed} elements in {size} bytes: it is damaged")


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def _largest(head: bytes, keyword: bytes) -> int:
    """The largest number that ends a line of that keyword."""
    found = 0
    for line in head.splitlines():
        words = line.split()
        if words[:1] == [keyword] and words[-1].isdigit():
            found = max(found, int(words[-1][:20]))
    return found


def _claimed_by_gltf(path: Path, size: int) -> tuple[int, int]:
    """The largest count of an accessor, and the bytes of the file with those it names."""
    try:
        document = json_from_text(_json_of(path))
        counts = [int(accessor["count"]) for accessor in document.get("accessors", [])]
        parts = [*document.get("buffers", []), *document.get("images", [])]
        named = [str(item["uri"]) for item in parts if "uri" in item]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise MapError(f"{path}: holds no triangles that could be a world ({error})") from None
    return max(counts, default=0), size + sum(_size_beside(path, uri) for uri in named)


def _check_materials(path: Path) -> None:
    """The files that an OBJ names for its colours, and the pictures that those name."""
    for name in _named(path, b"mtllib"):
        if _size_beside(path, name):
            for picture in _named(path.parent / name, b"map_"):
                _size_beside(path, picture)


def _named(path: Path, keyword: bytes) -> list[str]:
    """The last word of every line that begins so."""
    with path.open("rb") as stream:
        lines = [line.split() for line in stream if line.lstrip().startswith(keyword)]
    return [words[-1].decode("utf-8", "replace").replace("\\", "/") for words in lines if words[1:]]


def _size_beside(path: Path, uri: str) -> int:
    """Of a part of a world that lies in another file; those inside the text are counted already."""
    if uri.startswith("data:"):
        return 0
    try:
        beside = (path.parent / uri).resolve()
        stands, is_file = beside.exists(), beside.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, a zero byte, links in a ring
        raise MapError(f"{path}: names {uri!r}, which is no name of a file") from None
    if not beside.is_relative_to(path.parent.resolve()):
        raise MapError(f"{path}: names {uri}, outside its folder: copy that file beside it")
    if stands and not is_file:
        raise MapError(f"{path}: names {uri}, which is no file: a folder, a device or a pipe")
    return beside.stat().st_size if is_file else 0


def _json_of(path: Path) -> Any:
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return data
    if len(data) < _GLB.size:
        raise ValueError("cut short")
    length = _GLB.unpack_from(data)[3]
    return data[_GLB.size : _GLB.size + length]
