"""A node's images, as columns of RTAB-Map's Data table, both ways."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.database import image_blobs
from formats.database.node_rows import StorageOptions
from formats.picture_files import is_16_bit_png, is_grey
from mapmyworld.errors import MapError
from mapmyworld.types import CameraModel, ImageMessage, RgbdImage

_SIXTEEN_BITS = frozenset({"16UC1", "MONO16", "Z16"})


def colour_blob(images: tuple[RgbdImage, ...], options: StorageOptions) -> bytes | None:
    """One file for all cameras, side by side; a lone JPEG goes in as it was recorded."""
    colours = [image.colour for image in images]
    lone = colours[0].encoded if len(colours) == 1 and colours[0] is not None else None
    if lone is not None and lone.startswith(image_blobs.JPEG_MAGIC):
        return lone
    joined = _side_by_side(colours, "colour images")
    if joined is None:
        return None
    return image_blobs.encode_picture(joined, options.image_codec, options.image_quality)


def depth_blob(images: tuple[RgbdImage, ...], options: StorageOptions) -> bytes | None:
    """The same of depth; a lone PNG of 16 bits goes in, which is how RTAB-Map keeps it too."""
    depths = [image.depth for image in images]
    lone = depths[0] if len(depths) == 1 and options.depth_codec != "float" else None
    sixteen = lone.encoded if lone and lone.encoding.upper() in _SIXTEEN_BITS else None
    if sixteen is not None and is_16_bit_png(sixteen):
        return sixteen
    joined = _side_by_side(depths, "depth images")
    return None if joined is None else image_blobs.encode_depth(joined, options.depth_codec)


def _side_by_side(messages: list[ImageMessage | None], what: str) -> NDArray[np.generic] | None:
    """All images left to right; a missing one is black. None where all are missing."""
    images = [None if message is None else message.pixels() for message in messages]
    there = [image for image in images if image is not None]
    if not there:
        return None
    if len(images) == 1:
        return there[0]
    if len({(image.shape, image.dtype) for image in there}) != 1:
        raise MapError(f"{what} of one node differ in size: RTAB-Map's database keeps equal ones")
    black = np.zeros_like(there[0])
    return np.concatenate([black if image is None else image for image in images], axis=1)


def columns_to_images(
    image: bytes | None,
    depth: bytes | None,
    eyes: tuple[tuple[CameraModel, float | None], ...],
    stamps: list[int],
    what: str,
) -> tuple[RgbdImage, ...]:
    """One a camera, of which `eyes` give the calibration and a stereo pair's scale; at least one.

    Of a stereo pair, depth is worked out from both images when it is asked for.
    """
    cameras, scales = [camera for camera, _ in eyes], [scale for _, scale in eyes]
    picture = image_blobs.decode_picture
    colours = _strips(image, len(eyes), stamps, f"{what}'s image", picture, "rgb8")
    if scales[0] is None:
        deep = image_blobs.decode_depth
        depths = _strips(depth, len(eyes), stamps, f"{what}'s depth", deep, "32FC1")
    else:
        rights = _strips(depth, len(eyes), stamps, f"{what}'s right image", picture, "rgb8")
        pairs = zip(colours, rights, scales, strict=True)
        depths = [_stereo_depth(left, right, scale or 0.0, what) for left, right, scale in pairs]
    return tuple(map(RgbdImage, cameras, colours, depths))


def _stereo_depth(
    left: ImageMessage | None, right: ImageMessage | None, scale: float, what: str
) -> ImageMessage | None:
    if left is None or right is None or scale <= 0.0:
        return None

    def pixels() -> NDArray[np.float32]:
        return image_blobs.depth_from_pair(
            np.asarray(left.pixels(), np.uint8), np.asarray(right.pixels(), np.uint8), scale, what
        )

    return replace(left, encoding="32FC1", pixels=pixels, encoded=None)


def _strips(
    data: bytes | None,
    count: int,
    stamps: list[int],
    what: str,
    decode: Callable[[bytes, str], NDArray[Any]],
    encoding: str,
) -> list[ImageMessage | None]:
    """The images of `count` cameras in one file, decoded when asked for."""
    if data is None or len(data) <= 4:
        return [None] * count
    width, height = image_blobs.image_size(data, what)
    if encoding == "rgb8" and is_grey(data):
        encoding = "mono8"
    strip = width // count
    # What one camera asks for is at hand for the others.
    whole = partial(decode, data, what) if count == 1 else cache(partial(decode, data, what))

    def pixels_of(index: int) -> Callable[[], NDArray[Any]]:
        return lambda: whole()[:, index * strip : (index + 1) * strip]

    stamps = stamps + stamps[-1:] * (count - len(stamps))
    return [
        ImageMessage(
            stamp_ns=stamps[i],
            frame_id=f"camera_{i}",
            encoding=encoding,
            width=strip,
            height=height,
            pixels=pixels_of(i),
            encoded=data if count == 1 else None,
        )
        for i in range(count)
    ]
