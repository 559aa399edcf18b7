"""Depth files decoded without OpenCV: the very pixels that it decodes, or none."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formats.depth_png import plain_grey_16
from formats.picture_files import decoded_file


def chunk(name: bytes, content: bytes) -> bytes:
    body = name + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def png(
    cells: np.ndarray, kinds: list[int], *, more: bytes = b"", head: bytes = b"\x10\0\0\0\0"
) -> bytes:
    """A file whose rows claim to be filtered by `kinds`; their content is drawn blindly."""
    height, width = cells.shape
    lines = cells.astype(">u2").view(np.uint8).reshape(height, -1)
    stream = zlib.compress(
        b"".join(bytes([kind]) + bytes(line) for kind, line in zip(kinds, lines, strict=True))
    )
    half = len(stream) // 2
    parts = [chunk(b"IHDR", struct.pack(">2I", width, height) + head), more]
    parts += [chunk(b"IDAT", stream[:half]), chunk(b"IDAT", stream[half:]), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@given(st.integers(1, 9), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_every_filter_gives_the_cells_of_opencv(width: int, height: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    reported = random.integers(0, 1 << 16, (height, width), np.uint16)
    file = png(reported, random.integers(0, 5, height).tolist())
    cells = plain_grey_16(file)
    assert cells is not None
    assert cells.dtype == np.uint16
    np.testing.assert_array_equal(cells, cv2.imdecode(np.frombuffer(file, np.uint8), -1))


def test_what_opencv_writes_is_read_back() -> None:
    depth = (np.add.outer(np.arange(48) ** 2, np.arange(64) * 300) % 9000).astype(np.uint16)
    file = cv2.imencode(".png", depth)[1].tobytes()
    np.testing.assert_array_equal(plain_grey_16(file), depth)


_CELLS = np.arange(12, dtype=np.uint16).reshape(3, 4)
_NO_FILTER = [0, 0, 0]


def test_text_beside_the_pixels_changes_nothing() -> None:
    file = png(_CELLS, _NO_FILTER, more=chunk(b"tEXt", b"Title\0depth"))
    np.testing.assert_array_equal(plain_grey_16(file), _CELLS)


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(png(_CELLS, _NO_FILTER, more=chunk(b"tRNS", b"\0\1")), id="a colour is clear"),
        pytest.param(png(_CELLS, _NO_FILTER, head=b"\x10\0\0\0\1"), id="interlaced"),
        pytest.param(png(_CELLS, [0, 7, 0]), id="an unknown filter"),
        pytest.param(png(_CELLS, _NO_FILTER)[:-20], id="cut"),
        pytest.param(png(_CELLS, _NO_FILTER).replace(b"R\0\0\0\4", b"R\0\0\0\5"), id="a wrong sum"),
        pytest.param(png(_CELLS[:2], [0, 0]).replace(
            chunk(b"IHDR", struct.pack(">2I", 4, 2) + b"\x10\0\0\0\0"),
            chunk(b"IHDR", struct.pack(">2I", 4, 3) + b"\x10\0\0\0\0")), id="rows are missing"),
        pytest.param(b"", id="nothing"),
    ],
)  # fmt: skip
def test_what_is_out_of_the_ordinary_is_left_to_opencv(file: bytes) -> None:
    assert plain_grey_16(file) is None


def test_a_clear_colour_is_decoded_as_ever() -> None:
    file = png(_CELLS, _NO_FILTER, more=chunk(b"tRNS", b"\0\1"))
    expected = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded_file(file, cv2.IMREAD_UNCHANGED), expected)
