"""What a mesh file claims to hold, against what it is: Open3D takes room for a claim unseen."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from mapmyworld.errors import MapError

_GLB = struct.Struct("<4sIIII")  # magic, version, length; then the first chunk's length and kind
_HEAD_BYTES = 1 << 16


def check_claims(path: Path) -> None:
    """Raises `MapError` where the file claims more elements than its bytes could hold."""
    suffix, size = path.suffix.lower(), path.stat().st_size
    claimed = 0
    if suffix in (".glb", ".gltf"):
        claimed, size = _claimed_by_gltf(path, size)
    elif suffix == ".ply":
        claimed = _largest(_head(path).partition(b"end_header")[0], b"element")
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
        document = json.loads(_json_of(path))
        counts = [int(accessor["count"]) for accessor in document.get("accessors", [])]
        named = [str(item["uri"]) for item in document.get("buffers", []) if "uri" in item]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise MapError(f"{path}: holds no triangles that could be a world ({error})") from None
    return max(counts, default=0), size + sum(_size_beside(path, uri) for uri in named)


def _size_beside(path: Path, uri: str) -> int:
    """Of a part of a world that lies in another file; those inside the text are counted already."""
    if uri.startswith("data:"):
        return 0
    beside = (path.parent / uri).resolve()
    if not beside.is_relative_to(path.parent.resolve()):
        raise MapError(f"{path}: names {uri}, outside its folder: copy that file beside it")
    return beside.stat().st_size if beside.is_file() else 0


def _json_of(path: Path) -> Any:
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return data
    if len(data) < _GLB.size:
        raise ValueError("cut short")
    length = _GLB.unpack_from(data)[3]
    return data[_GLB.size : _GLB.size + length]
