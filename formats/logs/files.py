"""Opening files of a log: plain or compressed, hashed, with errors a user can act on."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import io
import os
import tempfile
import weakref
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, cast

import zstandard

from formats.limits import limits
from mapmyworld.errors import LogError

_READ_BYTES = 1 << 20
_ZSTD_BYTES = 1 << 12  # read at once: they may unpack to thirty thousand times as much
# What a decompressor raises at damage: cut streams, bad checksums, bad blocks.
DECOMPRESSION_ERRORS = (EOFError, OSError, ValueError, zlib.error, zstandard.ZstdError)


def open_binary(path: Path) -> BinaryIO:
    """The file's bytes, decompressed on the fly where its name ends in .bz2 or .gz.

    Raises `LogError` where it cannot be opened.
    """
    try:
        if path.suffix == ".bz2":
            return cast(BinaryIO, bz2.open(path, "rb"))
        if path.suffix == ".gz":
            return cast(BinaryIO, gzip.open(path, "rb"))
        return path.open("rb")
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror or error}") from error


def begins_about_as(start: bytes, magic: bytes) -> bool:
    """Whether a file begins with its mark, or with all of it but one damaged byte."""
    same = sum(a == b for a, b in zip(start, magic, strict=False))
    return same >= len(magic) - 1


class UnpackedFile:
    """A file that is read several times: a compressed one is unpacked once, beside the others.

    The copy lies in the system's folder for temporary files and goes with this object.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        """What was wrong with the rest of a compressed file, once it was unpacked."""
        self._copy: Path | None = None

    def plain(self) -> Path:
        """Where its plain bytes stand, as far as they can be unpacked."""
        if self.path.suffix not in {".bz2", ".gz", ".zstd"}:
            return self.path
        if self._copy is None:
            self._copy = self._unpack()
        return self._copy

    def problems(self) -> list[str]:
        """What is missing of it, for people."""
        cut = f"{self.path}: the packed file is cut or damaged: unpacked as far as it goes"
        return [cut] if self.damage else []

    def open(self) -> BinaryIO:
        """The plain bytes from the beginning."""
        return open_binary(self.plain())

    def _unpack(self) -> Path:
        most, (handle, name) = limits().unpacked_bytes, tempfile.mkstemp(prefix="mapmyworld-")
        weakref.finalize(self, Path.unlink, Path(name), missing_ok=True)
        with os.fdopen(handle, "wb") as copy, open_binary(self.path) as packed:
            read = cast(io.BufferedReader, packed).read1
            is_zstd = self.path.suffix == ".zstd"
            blocks = _unpacked_zstd(packed) if is_zstd else iter(lambda: read(_READ_BYTES), b"")
            try:
                for block in blocks:
                    if copy.tell() + len(block) > most:
                        raise LogError(
                            f"{self.path}: unpacks to more than {most >> 30} GB: if that is right, "
                            "set limits.unpacked_gb higher"
                        )
                    copy.write(block)
            except DECOMPRESSION_ERRORS as error:
                self.damage = str(error)
        return Path(name)


def _unpacked_zstd(packed: BinaryIO) -> Iterator[bytes]:
    """Of all frames; raises EOFError where the file ends within one."""
    frame = None
    while block := packed.read(_ZSTD_BYTES):
        while block:
            frame = frame or zstandard.ZstdDecompressor().decompressobj()
            yield frame.decompress(block)
            block, frame = (frame.unused_data, None) if frame.eof else (b"", frame)
    if frame is not None:
        raise EOFError("it is cut")


def hash_files(paths: Iterable[Path]) -> str:
    """SHA-256 over the bytes of the files, one after the other, as hexadecimal digits.

    Raises `LogError` where one cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        try:
            with path.open("rb") as stream:
                while block := stream.read(_READ_BYTES):
                    digest.update(block)
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    return digest.hexdigest()
