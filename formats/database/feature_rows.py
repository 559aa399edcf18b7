"""Local features and visual words as rows of RTAB-Map's tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.database.connection import Connection, Row
from mapmyworld.errors import MapError
from mapmyworld.types import Features

INSERT_FEATURE = "INSERT INTO Feature VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?)"
SELECT_FEATURES = (
    "SELECT word_id, pos_x, pos_y, size, dir, response, octave, depth_x, depth_y, depth_z,"
    " descriptor_size, descriptor FROM Feature WHERE node_id = ? ORDER BY rowid"
)
INSERT_WORD = "INSERT INTO Word (id, descriptor_size, descriptor) VALUES (?,?,?)"
SELECT_WORDS = "SELECT id, descriptor_size, descriptor FROM Word ORDER BY id"


def feature_rows(node_id: int, features: Features) -> Iterator[Row]:
    """One row a feature, in order; one without a word gets a negative id of its own."""
    count = len(features.pixels)
    alone = -1 - np.arange(count)
    words = alone if features.words is None else np.where(features.words > 0, features.words, alone)
    columns = [
        words.tolist(),
        *np.asarray(features.pixels, np.float64).T.tolist(),
        features.sizes.astype(np.int64).tolist(),
        *(np.nan_to_num(c).astype(float).tolist() for c in (features.angles, features.responses)),
        features.octaves.tolist(),
        # SQLite keeps NaN as NULL, which is RTAB-Map's "no depth".
        *np.asarray(features.points, np.float64).T.tolist(),
    ]
    size = features.descriptors.shape[1]
    descriptors = np.ascontiguousarray(features.descriptors)
    for i, values in enumerate(zip(*columns, strict=True)):
        yield (node_id, *values, size, descriptors[i].tobytes())


def features_from_rows(rows: Sequence[Row], what: str) -> Features | None:
    """The features of `SELECT_FEATURES`; None for none.

    Raises `MapError` where they are damaged; `what` names them.
    """
    if not rows:
        return None
    try:
        return _features(list(zip(*rows, strict=True)), what)
    except (TypeError, ValueError, OverflowError) as error:
        raise MapError(f"{what}: features that cannot be read ({error})") from None


def _features(columns: list[tuple[Any, ...]], what: str) -> Features:
    words = np.array(columns[0], np.int64)
    octaves = np.array(columns[6], np.int64)
    pixels, points = np.array(columns[1:3], np.float64), np.array(columns[7:10], np.float64)
    if not (np.abs(pixels) < FARTHEST).all() or (np.abs(points) > FARTHEST).any():
        raise ValueError(
            "a feature's pixel or point is out of range"
        )  # NULL, of a point, is NaN: no depth
    looks = np.array(columns[3:6], np.float64)
    if (np.abs(looks) > FARTHEST).any():
        raise ValueError("a feature's size, angle or response is out of range")
    return Features(
        pixels=pixels.T.astype(np.float32),
        points=points.T.astype(np.float32),
        descriptors=_descriptors(columns[10], columns[11], what),
        sizes=looks[0].astype(np.float32),
        angles=looks[1].astype(np.float32),
        responses=looks[2].astype(np.float32),
        octaves=octaves.astype(np.int32),
        words=np.where(words > 0, words, 0).astype(np.int32) if (words > 0).any() else None,
    )


def _descriptors(
    sizes: Sequence[int | None], blobs: Sequence[bytes | None], what: str
) -> NDArray[Any]:
    """Descriptors (N, D), all of one kind; (N, 0) where none were stored."""
    if all(not blob for blob in blobs):
        return np.zeros((len(blobs), 0), np.uint8)
    first = descriptor_from_blob(sizes[0], blobs[0], what)
    if any(blob is None or len(blob) != len(blobs[0] or b"") for blob in blobs):
        raise MapError(f"{what}: descriptors of different sizes")
    joined = b"".join(blob or b"" for blob in blobs)
    return np.frombuffer(joined, first.dtype).reshape(len(blobs), -1)


def descriptor_from_blob(size: int | None, blob: bytes | None, what: str) -> NDArray[Any]:
    """A descriptor (D,) of bytes or float32, by the length of its blob.

    Raises `MapError` where that fits neither; `what` names it.
    """
    if blob is not None and size is not None and len(blob) == size:
        return np.frombuffer(blob, np.uint8)
    if blob is not None and size is not None and len(blob) == 4 * size:
        return np.frombuffer(blob, "<f4")
    held = "no" if blob is None else len(blob)
    raise MapError(f"{what}: a descriptor of {size} elements in {held} bytes")


def read_words(db: Connection) -> dict[int, NDArray[Any]]:
    """The vocabulary: word id -> descriptor (D,)."""
    return {
        word_id: descriptor_from_blob(size, blob, f"{db.path}: word {word_id}")
        for word_id, size, blob in db.iterate(SELECT_WORDS)
    }
