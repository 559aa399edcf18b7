"""A vocabulary of visual words as text, so that many maps can share their words.

The first line says how long a descriptor is; each further line is a word's number and the 32 bytes
of its descriptor as decimal numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.whole_files import write_whole
from mapmyworld.errors import MapError

_HEAD = "WordID Descriptors..."
_BYTES = 32  # of a binary descriptor
_SQLITE = b"SQLite format 3\x00"

Words = dict[int, NDArray[np.uint8]]


def read_vocabulary(path: Path) -> Words:
    """Word number -> descriptor (32,), of a text file or of any map that has words.

    Raises `MapError` where it has none.
    """
    try:
        with path.open("rb") as file:
            is_map = file.read(len(_SQLITE)) == _SQLITE
        words = _words_of_map(path) if is_map else _parsed(path.read_bytes(), path)
    except OSError as error:
        raise MapError(
            f"{path}: the vocabulary cannot be read ({error.strerror}): check places.vocabulary"
        ) from None
    if not words:
        raise MapError(f"{path}: there are no visual words in it: give a map made with a camera")
    return words


def write_vocabulary(path: Path, words: Mapping[int, NDArray[np.generic]]) -> None:
    """The words as text, by their numbers: number -> descriptor (32,).

    Raises `MapError` where there are none.
    """
    if not words:
        raise MapError(f"{path}: the map has no visual words to write: it was made without images")
    lines = [f"{_HEAD}{_BYTES}"]
    for number in sorted(words):
        descriptor = _checked(words[number], f"{path}: word {number}")
        lines.append(" ".join(map(str, [number, *descriptor.tolist()])))
    write_whole(path, "\n".join(lines) + "\n")


def _words_of_map(path: Path) -> Words:
    from formats.database import open_store

    with open_store(path, read_only=True) as store:
        found = store.words()
    return {n: _checked(word, f"{path}: word {n}") for n, word in found.items() if n > 0}


def _checked(descriptor: NDArray[np.generic], what: str) -> NDArray[np.uint8]:
    if descriptor.dtype != np.uint8 or descriptor.shape != (_BYTES,):
        raise MapError(
            f"{what} is {descriptor.size} numbers of {descriptor.dtype}, not {_BYTES} bytes: only "
            "binary words can be used"
        )
    return np.asarray(descriptor, np.uint8)


def _parsed(data: bytes, path: Path) -> Words:
    lines = data.decode("ascii", "replace").splitlines()
    if not lines or not lines[0].startswith(_HEAD):
        raise MapError(f'{path}: no vocabulary: its first line is not "{_HEAD}{_BYTES}"')
    words: Words = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            word, *values = (int(text) for text in line.split())
            words[word] = np.array(values, np.uint8)
        except (ValueError, OverflowError):
            raise MapError(
                f"{path}, line {number}: not a word's number and {_BYTES} bytes"
            ) from None
        if len(values) != _BYTES or word <= 0:
            raise MapError(
                f"{path}, line {number}: {len(values)} bytes of word {word}, not {_BYTES}"
            )
    return words
