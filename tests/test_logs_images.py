"""Pixels: every encoding against a picture whose values are known, and damaged pictures."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_builders import allowed, changes, damaged
from numpy.typing import NDArray
from rtabmap_decoder import rvl_words

from formats.logs.image_pixels import compressed_image, decode_rvl
from formats.logs.ros_decoders import image
from formats.picture_files import picture_size
from mapmyworld.errors import LogError
from mapmyworld.types import ImageMessage

RGB = np.random.default_rng(1).integers(0, 256, (6, 8, 3), np.uint8)
GREY = RGB[..., 0].copy()
DEPTH_MM = np.array([[0, 500, 1234], [65535, 1, 2000]], np.uint16)


def raw_image(
    encoding: str, width: int, height: int, step: int, data: bytes, big_endian: bool = False
) -> ImageMessage:
    size = {"width": width, "height": height, "step": step}
    return image(SimpleNamespace(encoding=encoding, **size, data=data, is_bigendian=big_endian))


def decode(
    encoding: str, cells: NDArray[np.generic], *, pad: int = 0, big_endian: bool = False
) -> NDArray[np.generic]:
    """A picture sent raw, each row followed by `pad` bytes."""
    height, width = cells.shape[:2]
    if big_endian:
        cells = cells.astype(cells.dtype.newbyteorder(">"))
    rows = np.ascontiguousarray(cells).view(np.uint8).reshape(height, -1)
    data = np.hstack([rows, np.full((height, pad), 7, np.uint8)]).tobytes()
    step = rows.shape[1] + pad
    message = raw_image(encoding, width, height, step, data, big_endian)
    assert (message.width, message.height, message.encoding) == (width, height, encoding)
    return message.pixels()


ALPHA = np.full((6, 8, 1), 255, np.uint8)


@pytest.mark.parametrize("pad", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "cells"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("8UC3", RGB[..., ::-1]),
        ("rgba8", np.concatenate([RGB, ALPHA], 2)),
        ("bgra8", np.concatenate([RGB[..., ::-1], ALPHA], 2)),
        ("8UC4", np.concatenate([RGB[..., ::-1], ALPHA], 2)),
    ],
)
def test_colour_is_rgb(encoding: str, cells: NDArray[np.uint8], pad: int) -> None:
    np.testing.assert_array_equal(decode(encoding, cells, pad=pad), RGB)


@pytest.mark.parametrize("big_endian", [False, True])
def test_deep_colour_keeps_its_high_bytes(big_endian: bool) -> None:
    deep = RGB.astype(np.uint16) * 256 + 77
    np.testing.assert_array_equal(decode("rgb16", deep, big_endian=big_endian), RGB)
    np.testing.assert_array_equal(decode("bgr16", deep[..., ::-1], big_endian=big_endian), RGB)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_stays_as_recorded(encoding: str) -> None:
    np.testing.assert_array_equal(decode(encoding, GREY, pad=3), GREY)


@pytest.mark.parametrize("encoding", ["16UC1", "mono16", "z16"])
@pytest.mark.parametrize("big_endian", [False, True])
def test_integer_depth_is_millimetres(encoding: str, big_endian: bool) -> None:
    metres = decode(encoding, DEPTH_MM, pad=2, big_endian=big_endian)
    assert metres.dtype == np.float32
    np.testing.assert_allclose(metres, DEPTH_MM / 1000.0, rtol=1e-6)
    assert metres[0, 0] == 0


def test_float_depth_is_metres_with_zero_for_none() -> None:
    cells = np.array([[1.5, np.nan], [np.inf, -2.0]], np.float32)
    np.testing.assert_array_equal(decode("32FC1", cells), [[1.5, 0], [0, 0]])


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("deep", [False, True])
def test_bayer_gives_an_even_colour_back(pattern: str, deep: bool) -> None:
    """A surface of one colour needs no guessing between neighbours."""
    colour = {"r": 200, "g": 100, "b": 50}
    tile = np.array([colour[c] for c in pattern], np.uint8).reshape(2, 2)
    cells = np.tile(tile, (4, 4))
    if deep:
        pixels = decode(f"bayer_{pattern}16", cells.astype(np.uint16) * 256)
    else:
        pixels = decode(f"bayer_{pattern}8", cells)
    np.testing.assert_array_equal(pixels[2:-2, 2:-2], np.broadcast_to([200, 100, 50], (4, 4, 3)))


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0)])
def test_yuv_of_grey(encoding: str, luma: int) -> None:
    """Without colour (U = V = 128) video levels 16..235 stretch to 0..255 (BT.601)."""
    cells = np.full((2, 4, 2), 128, np.uint8)
    cells[..., luma] = [[16, 126, 235, 16]] * 2
    pixels = decode(encoding, cells)
    np.testing.assert_allclose(pixels[0, :, 0], [0, 128, 255, 0], atol=1)
    assert np.ptp(pixels.astype(int), axis=2).max() <= 1


def test_unknown_encodings_and_short_data_are_refused_when_asked_for() -> None:
    for message, says in (
        (raw_image("holo3", 2, 2, 2, bytes(4)), "holo3"),
        (raw_image("rgb8", 2, 2, 6, bytes(11)), "does not fit"),
        (raw_image("rgb8", 2, 2, 5, bytes(12)), "does not fit"),
        (raw_image("mono8", 1 << 31, 1 << 31, 1 << 31, bytes(4)), "does not fit"),
        (raw_image("mono8", 0, 0, 0, b""), "does not fit"),
    ):
        with pytest.raises(LogError, match=says):
            message.pixels()


def file(extension: str, cells: NDArray[np.generic]) -> bytes:
    return cv2.imencode(extension, cells)[1].tobytes()


@pytest.mark.parametrize(
    "described", ["png", "rgb8; png compressed bgr8", "bgr8; png compressed bgr8", ""]
)
def test_compressed_colour_keeps_its_file(described: str) -> None:
    data = file(".png", RGB[..., ::-1])
    message = compressed_image(1, "c", described, data)
    np.testing.assert_array_equal(message.pixels(), RGB)
    assert message.encoded == data
    assert (message.width, message.height) == (8, 6)
    assert not message.is_depth


def test_jpeg_and_grey() -> None:
    smooth = np.add.outer(np.arange(40), np.arange(60)).astype(np.uint8)
    data = file(".jpg", smooth)
    message = compressed_image(1, "c", "jpeg", data)
    assert (message.width, message.height) == picture_size(data) == (60, 40)
    assert np.abs(message.pixels().astype(int) - smooth).max() < 6
    assert message.pixels().ndim == 2


def test_a_compressed_mosaic_is_given_its_colours() -> None:
    """One channel under a Bayer name is the mosaic; three are colours already."""
    cells = np.tile(np.array([[200, 100], [100, 50]], np.uint8), (4, 4))
    mosaic = compressed_image(1, "c", "bayer_rggb8; png compressed ", file(".png", cells))
    np.testing.assert_array_equal(mosaic.pixels()[3, 3], [200, 100, 50])
    colour = compressed_image(1, "c", "bayer_rggb8; png compressed bgr8", file(".png", RGB))
    np.testing.assert_array_equal(colour.pixels(), RGB[..., ::-1])


def test_png_of_sixteen_bits_is_depth() -> None:
    message = compressed_image(1, "c", "16UC1; png compressed ", file(".png", DEPTH_MM))
    assert message.is_depth
    np.testing.assert_allclose(message.pixels(), DEPTH_MM / 1000.0, rtol=1e-6)
    assert compressed_image(1, "c", "png", file(".png", DEPTH_MM)).encoding == "16UC1"


HEADER = struct.pack("<iff", 0, 0.0, 0.0)


def test_compressed_depth_png_in_millimetres() -> None:
    data = file(".png", DEPTH_MM)
    message = compressed_image(1, "c", "16UC1; compressedDepth png", HEADER + data)
    assert message.is_depth
    assert message.encoded == data
    assert (message.width, message.height) == (3, 2)
    np.testing.assert_allclose(message.pixels(), DEPTH_MM / 1000.0, rtol=1e-6)


def test_compressed_depth_of_floats_is_inverse_depth() -> None:
    """Depth = A / (value - B); value 0 says "none"."""
    a, b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    values = np.array([[0, 1, 9092]], np.uint16)
    data = struct.pack("<iff", 0, a, b) + file(".png", values)
    message = compressed_image(1, "c", "32FC1; compressedDepth png", data)
    expected = np.array([[0.0, a / (1 - b), a / (9092 - b)]])
    np.testing.assert_allclose(message.pixels(), expected, rtol=1e-6)
    assert expected[0, 1] == pytest.approx(10.0)
    assert message.encoded is None


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    return struct.pack("<II", depth.shape[1], depth.shape[0]) + rvl_words(depth)


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
        lambda size: st.lists(
            st.one_of(st.just(0), st.integers(0, 65535)),
            min_size=size[0] * size[1],
            max_size=size[0] * size[1],
        ).map(lambda values: np.array(values, np.uint16).reshape(size))
    )
)
def test_rvl_round_trip(depth: NDArray[np.uint16]) -> None:
    np.testing.assert_array_equal(decode_rvl(encode_rvl(depth)), depth)


def test_rvl_message() -> None:
    message = compressed_image(1, "c", "16UC1; compressedDepth rvl", HEADER + encode_rvl(DEPTH_MM))
    np.testing.assert_allclose(message.pixels(), DEPTH_MM / 1000.0, rtol=1e-6)


@settings(max_examples=150)
@given(st.sampled_from(["png", "jpg", "rvl", "depth"]), changes(), st.floats(0.0, 1.0))
def test_damaged_pictures_raise_log_errors_only(
    kind: str, wrong: list[tuple[float, int]], kept: float
) -> None:
    whole = {
        "png": file(".png", RGB),
        "jpg": file(".jpg", RGB),
        "rvl": HEADER + encode_rvl(DEPTH_MM),
        "depth": HEADER + file(".png", DEPTH_MM),
    }[kind]
    described = {"rvl": "16UC1; compressedDepth rvl", "depth": "16UC1; compressedDepth png"}
    message = compressed_image(1, "c", described.get(kind, kind), damaged(whole, wrong, kept))
    pixels = allowed(message.pixels)
    assert pixels is None or pixels.ndim in {2, 3}
