"""Opening files of a log: plain or compressed, hashed, with errors a user can act on."""

from __future__ import annotations

import bz2
import gzip
import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO, cast

from mapmyworld.errors import LogError

_READ_BYTES = 1 << 20
# What a decompressor raises at damage: cut streams, bad checksums, bad blocks.
DECOMPRESSION_ERRORS = (EOFError, OSError, ValueError)


def open_binary(path: Path) -> BinaryIO:
    """The file's bytes, decompressed on the fly where its name ends in .bz2 or .gz."""
    try:
        if path.suffix == ".bz2":
            return cast(BinaryIO, bz2.open(path, "rb"))
        if path.suffix == ".gz":
            return cast(BinaryIO, gzip.open(path, "rb"))
        return path.open("rb")
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror or error}") from error


def hash_files(paths: Iterable[Path]) -> str:
    """SHA-256 over the bytes of the files, one after the other, as hexadecimal digits."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            with path.open("rb") as stream:
                while block := stream.read(_READ_BYTES):
                    digest.update(block)
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    return digest.hexdigest()
