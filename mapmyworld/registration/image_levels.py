"""Grey levels and colours of images, decoded no finer than they are wanted."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from isal.isal_zlib import crc32
from numpy.typing import NDArray

from mapmyworld.types import ImageMessage, RgbdImage

_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
_REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
_REDUCED[8] = cv2.IMREAD_REDUCED_COLOR_8
_GREY = np.full((1, 1, 3), 128, np.uint8)  # where there is no colour image


def grey_picture(image: RgbdImage) -> NDArray[np.uint8]:
    """The colour image as (H, W) grey levels; of a JPEG only its luminance is decoded."""
    assert image.colour is not None
    grey = _decoded(image.colour, cv2.IMREAD_GRAYSCALE)
    if grey is not None:
        return grey
    picture = np.asarray(image.colour.pixels(), np.uint8)
    return picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))


def colours_at(image: RgbdImage, pixels: NDArray[np.floating], spacing: int) -> NDArray[np.uint8]:
    """RGB (N, 3) of pixels (N, 2) that lie `spacing` apart; grey 128 without a colour image.

    Each is the mean of the pixels around it where a JPEG gives that for less than the image.
    """
    picture = _small_picture(image.colour, spacing)
    size = np.array([image.camera.width, image.camera.height]) / picture.shape[1::-1]
    cells = np.floor((pixels + 0.5) / size).astype(np.int64)
    u, v = np.clip(cells, 0, np.array(picture.shape[1::-1]) - 1).T
    found = picture[v, u]
    return found if found.ndim == 2 else np.repeat(found[:, None], 3, axis=1)


def _small_picture(colour: ImageMessage | None, spacing: int) -> NDArray[np.uint8]:
    if colour is None:
        return _GREY
    factor = max((f for f in _REDUCED if f <= spacing), default=1)
    small = _decoded(colour, _REDUCED[factor]) if factor > 1 else None
    if small is None:
        return np.asarray(colour.pixels(), np.uint8)
    return small[..., ::-1]


def decodes(colour: ImageMessage, shape: tuple[int, int]) -> bool:
    """Whether a JPEG can be decoded to this height and width, by an eighth of its pixels."""
    small = _decoded(colour, cv2.IMREAD_REDUCED_GRAYSCALE_8)
    eighth = tuple(-(-side // 8) for side in shape)
    return small is not None and small.shape == eighth and (colour.height, colour.width) == shape


def is_whole_png(depth: ImageMessage, shape: tuple[int, int]) -> bool:
    """Whether depth came as a PNG of 16 bits and this height and width, and its sums are right.

    A file whose every chunk bears its checksum out need not be decoded to be believed (PNG
    specification, section 5).
    """
    data = depth.encoded
    head = struct.pack(">2I", shape[1], shape[0]) + b"\x10\x00"  # 16 bits of grey
    if data is None or data[:8] != _PNG or data[12:26] != b"IHDR" + head:
        return False
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 8 + length
        if crc32(data[at + 4 : end]).to_bytes(4, "big") != data[end : end + 4]:
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def _decoded(colour: ImageMessage, mode: int) -> NDArray[np.uint8] | None:
    """A JPEG decoded so; None where the image is something else, or damaged."""
    data = colour.encoded
    if data is None or not data.startswith(_JPEG) or colour.encoding.lower().startswith("bayer"):
        return None
    try:
        cells = cv2.imdecode(np.frombuffer(data, np.uint8), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    return None if cells is None else np.asarray(cells, np.uint8)
