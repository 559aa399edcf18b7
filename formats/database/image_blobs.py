"""Images as blobs: JPEG or PNG for colour, PNG for depth, or RVL; sizes checked before decoding.

A node may keep the right image of a stereo pair in place of depth.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.limits import limits
from formats.picture_files import decoded_file, encoded_file, picture_size
from mapmyworld.errors import MapError

JPEG_MAGIC = b"\xff\xd8\xff"
_RVL_MAGIC = b"DEPTHRVL"
_MAX_MILLIMETRES = 65535
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_DEPTH_PNG = (*_FAST_PNG, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)


def image_size(data: bytes, what: str) -> tuple[int, int]:
    """Width and height that a JPEG, PNG or RVL header states, once they are believable.

    Raises `MapError` where they are not; `what` names the image.
    """
    is_rvl = data.startswith(_RVL_MAGIC) and len(data) >= 16
    width, height = struct.unpack_from("<2I", data, 8) if is_rvl else picture_size(data)
    if not 0 < width * height <= limits().image_pixels:
        raise MapError(f"{what}: an image of {width} x {height} pixels is refused")
    return width, height


def decode_picture(data: bytes, what: str) -> NDArray[np.uint8]:
    """Colour (H, W, 3) RGB or grey (H, W); raises `MapError` where it is damaged."""
    pixels = _decode(data, what)
    if pixels.dtype != np.uint8:
        raise MapError(f"{what}: an image of {pixels.dtype}, not of bytes")
    if pixels.ndim == 2:
        return pixels.astype(np.uint8, copy=False)
    code = cv2.COLOR_BGRA2RGB if pixels.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(pixels, code), np.uint8)


def encode_picture(pixels: NDArray[np.generic], codec: str, quality: int) -> bytes:
    """JPEG or PNG bytes of colour (H, W, 3) RGB or grey (H, W)."""
    bytes_image = np.asarray(pixels, np.uint8)
    if bytes_image.ndim == 3:
        bytes_image = np.asarray(cv2.cvtColor(bytes_image, cv2.COLOR_RGB2BGR), np.uint8)
    if codec == "png":
        return encoded_file(".png", bytes_image, *_FAST_PNG)
    return encoded_file(".jpg", bytes_image, cv2.IMWRITE_JPEG_QUALITY, quality)


def encode_depth(metres: NDArray[np.generic], codec: str) -> bytes:
    """A PNG of depth (H, W) in metres, 0 or NaN = none: whole millimetres, or "float"."""
    depth = np.ascontiguousarray(metres, np.float32)
    if codec == "float":
        # RTAB-Map keeps a float's four bytes as the B, G, R, A of a pixel.
        return encoded_file(".png", depth.view(np.uint8).reshape(*depth.shape, 4), *_FAST_PNG)
    millimetres = np.rint(depth * np.float32(1000.0))
    # What 16 bits cannot hold is no depth at all, and neither is what is no number.
    millimetres[~((millimetres >= 0) & (millimetres <= _MAX_MILLIMETRES))] = 0
    return encoded_file(".png", millimetres.astype(np.uint16), *_DEPTH_PNG)


def decode_depth(data: bytes, what: str) -> NDArray[np.float32]:
    """Depth (H, W) in metres, 0 = none; raises `MapError` where it is damaged."""
    width, height = image_size(data, what)
    if data.startswith(_RVL_MAGIC):
        from formats.rvl import rvl_decode

        try:
            return rvl_decode(data[16:], height, width).astype(np.float32) * np.float32(1e-3)
        except ValueError as error:
            raise MapError(f"{what}: {error}") from None
    pixels = _decode(data, what)
    if pixels.dtype == np.uint16 and pixels.ndim == 2:
        return pixels.astype(np.float32) * np.float32(1e-3)
    if pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 4:
        metres = np.ascontiguousarray(pixels).view("<f4")[..., 0]
        return np.where(np.isfinite(metres), metres, 0.0).astype(np.float32)
    raise MapError(f"{what}: {pixels.dtype} pixels of shape {pixels.shape} are no depth image")


def _decode(data: bytes, what: str) -> NDArray[np.generic]:
    image_size(data, what)
    pixels = decoded_file(data, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise MapError(f"{what}: a damaged image")
    return np.asarray(pixels)


_BLOCK = 5  # pixels a side of what is compared
_SPAN = 16  # the widest disparity searched is a multiple of this
_SHARE = 0.15  # of the image's width: the widest disparity, for things near the camera
_SMOOTH, _JUMP = 8 * _BLOCK * _BLOCK, 32 * _BLOCK * _BLOCK  # prices of small and large steps
_FRACTION = 16.0  # parts of a pixel in which disparities are reported


def depth_from_pair(
    left: NDArray[np.uint8], right: NDArray[np.uint8], range_times_pixels: float, what: str
) -> NDArray[np.float32]:
    """Metres (H, W) at the pixels of a rectified left image, 0 where nothing matches.

    `left`, `right` are colour (H, W, 3) or grey (H, W). `range_times_pixels`: focal length [pixel]
    times baseline [m]. The disparity is found by semi-global matching (Hirschmueller 2008), as
    OpenCV has it. Raises `MapError` where the images differ in size.
    """
    if left.shape[:2] != right.shape[:2]:
        raise MapError(f"{what}: left and right image differ in size")
    pair = [i if i.ndim == 2 else cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in (left, right)]
    span = _SPAN * max(1, round(_SHARE * left.shape[1] / _SPAN))
    matcher = cv2.StereoSGBM.create(
        numDisparities=span,
        blockSize=_BLOCK,
        P1=_SMOOTH,
        P2=_JUMP,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    disparity = matcher.compute(pair[0], pair[1]).astype(np.float32) / _FRACTION
    seen = disparity > 0.5
    depth = np.zeros(disparity.shape, np.float32)
    depth[seen] = range_times_pixels / disparity[seen]
    return depth
