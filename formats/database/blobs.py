"""RTAB-Map's blobs: compressed matrices, transforms, information matrices.

A size that a blob claims is believed only as far as its bytes bear it out: decompression stops
at the claimed size, so a small blob cannot fill the memory.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST, LARGEST
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import SWAP_ROTATION_TRANSLATION, transforms_of_rows

# Between RTAB-Map's order of a tangent (translation first) and ours.
_SWAP = SWAP_ROTATION_TRANSLATION
# OpenCV's depth numbers; type = depth + 8 * (channels - 1).
_DEPTHS = ("u1", "i1", "<u2", "<i2", "<i4", "<f4", "<f8")
_TRAILER = struct.Struct("<3i")
MAX_MATRIX_BYTES = 1 << 30
# zlib cannot expand more than 1032 times; a claim beyond it is a lie.
_MAX_EXPANSION = 1040
_PIECE = 1 << 24  # bytes that are unpacked at once
_COMPRESSION = 6  # zlib's default, as RTAB-Map's writer uses
# Level for what comes with every node: the default takes up to six times as long, saves a ninth.
# igzip takes a quarter of it, but gives other bytes from run to run: its tables begin as they lie.
FAST = 1
STORED = 0  # as it is: for what hardly shrinks


def matrix_to_blob(matrix: NDArray[np.generic], level: int = _COMPRESSION) -> bytes | None:
    """A compressed matrix (R, C) or (R, C, K) of K channels; None for an empty one."""
    if matrix.size == 0:
        return None
    rows, cols = matrix.shape[:2]
    channels = matrix.shape[2] if matrix.ndim == 3 else 1
    depth = _DEPTHS.index(np.dtype(matrix.dtype).newbyteorder("<").str.lstrip("|"))
    packed = zlib.compress(np.ascontiguousarray(matrix).data, level)
    return packed + _TRAILER.pack(rows, cols, depth + 8 * (channels - 1))


def blob_to_matrix(blob: bytes | None, what: str) -> NDArray[np.generic] | None:
    """The matrix (R, C, K) of a blob, of K channels; None where it is absent.

    Raises `MapError` where it is damaged; `what` names it.
    """
    if blob is None or (isinstance(blob, bytes) and len(blob) <= 4):
        return None
    if not isinstance(blob, bytes):
        raise MapError(f"{what}: a {type(blob).__name__} is no compressed matrix")
    if len(blob) < _TRAILER.size:
        raise MapError(f"{what}: {len(blob)} bytes are too few for a compressed matrix")
    rows, cols, kind = _TRAILER.unpack(blob[-_TRAILER.size :])
    depth, channels = kind & 7, (kind >> 3) + 1
    if rows < 0 or cols < 0 or kind < 0 or depth >= len(_DEPTHS) or channels > 64:
        raise MapError(f"{what}: no matrix has {rows} rows, {cols} columns and type {kind}")
    dtype = np.dtype(_DEPTHS[depth])
    size = rows * cols * channels * dtype.itemsize
    data = inflate(blob[: -_TRAILER.size], size, what)
    return np.frombuffer(data, dtype).reshape(rows, cols, channels)


def inflate(stream: bytes, size: int, what: str) -> bytearray:
    """Exactly `size` bytes of a zlib stream.

    Raises `MapError` where it holds others; `what` names it.
    """
    if size > MAX_MATRIX_BYTES or size > len(stream) * _MAX_EXPANSION + 64:
        raise MapError(f"{what}: {len(stream)} compressed bytes cannot hold the {size} claimed")
    decoder, data = zlib.decompressobj(), bytearray()
    try:
        while piece := decoder.decompress(stream, min(_PIECE, size + 1 - len(data))):
            data += piece  # in place, where one call for all of it would hold it twice
            stream = decoder.unconsumed_tail
            if len(data) > size:
                break
    except zlib.error as error:
        raise MapError(f"{what}: damaged compressed data ({error})") from None
    if len(data) != size:
        held = "more" if len(data) > size else str(len(data))
        raise MapError(f"{what}: claims {size} bytes and holds {held}")
    return data


def pose_to_blob(a_from_b: NDArray[np.float64]) -> bytes:
    """A motion (4, 4) as 12 float32, the upper three rows."""
    return np.asarray(a_from_b[:3], "<f4").tobytes()


def blob_to_pose(blob: bytes | None, what: str) -> NDArray[np.float64] | None:
    """A motion (4, 4); None for NULL or zeros. The rotation is made orthonormal again.

    Raises `MapError` where it is damaged; `what` names it.
    """
    if blob is None or len(blob) == 0:
        return None
    if len(blob) != 48:
        raise MapError(f"{what}: a transform takes 48 bytes, not {len(blob)}")
    poses = transforms_of_rows(np.frombuffer(blob, "<f4"))
    if not (np.abs(poses) <= FARTHEST).all():
        raise MapError(f"{what}: a transform that is not finite, or out of range")
    return None if not poses[0, :3].any() else orthonormal(poses)[0]


def doubles(blob: Any, side: int) -> NDArray[np.float64]:
    """A square matrix (K, K), K = `side`; `ValueError` where it is damaged or beyond sense."""
    found = np.frombuffer(blob, "<f8").reshape(side, side)
    most = FARTHEST if side == 4 else LARGEST  # those of side 4 are motions
    if not (np.abs(found) <= most).all():
        raise ValueError("a value that is not finite, or out of range")
    return found


def orthonormal(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motions with the nearest true rotations, (N, 4, 4) both: float32 leaves errors of 1e-7."""
    u, _, vt = np.linalg.svd(poses[:, :3, :3])
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    nearest = poses.copy()
    nearest[:, :3, :3] = u @ vt
    return nearest


def information_to_blobs(information: NDArray[np.float64]) -> list[bytes]:
    """288 bytes each, translation first, of rotation-first matrices (N, 6, 6).

    Without the bits in which products leave them unlike their transposes: RTAB-Map's tools hand
    them to g2o, which refuses a graph with one that is not exactly symmetric.
    """
    halves = 0.5 * information  # a sum may overflow
    swapped = (halves + halves.transpose(0, 2, 1))[:, _SWAP[:, None], _SWAP].astype("<f8")
    swapped[~np.isfinite(swapped)] = 0.0
    # RTAB-Map aborts on a component that is not positive; 1/9999 is its "ignore this one".
    diagonal = np.einsum("nii->ni", swapped)
    weak = diagonal <= 0.0
    swapped[weak] = swapped.transpose(0, 2, 1)[weak] = 0.0
    diagonal[weak] = 1.0 / 9999.0
    return [one.tobytes() for one in swapped]


def blob_to_information(blob: bytes, what: str) -> NDArray[np.float64]:
    """Information (6, 6), rotation first.

    Raises `MapError` where it is damaged; `what` names it.
    """
    if len(blob) != 288:
        raise MapError(f"{what}: an information matrix takes 288 bytes, not {len(blob)}")
    matrix = np.frombuffer(blob, "<f8").reshape(6, 6)
    if not np.isfinite(matrix).all():
        raise MapError(f"{what}: an information matrix that is not finite")
    return np.asarray(matrix[_SWAP[:, None], _SWAP], np.float64)
