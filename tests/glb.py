"""Binary glTF 2.0 by its standard, for worlds that other programs made."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def write_glb(path: Path, document: Mapping[str, Any], parts: Sequence[bytes]) -> None:
    """A document and the parts of its one buffer, whose lengths are multiples of four."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)
    whole = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    whole += struct.pack("<I4s", len(text), b"JSON") + text
    path.write_bytes(whole + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
