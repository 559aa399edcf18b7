"""Images that do not decode, or not to what the plan was made for: replaced by nothing seen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.types import CameraModel, ImageMessage, RgbdImage


class ImageGuard:
    """Lets images through that decode; others are blank, and counted once each."""

    def __init__(self) -> None:
        self._failed: dict[tuple[bool, str, int], str] = {}

    @property
    def failures(self) -> int:
        """Images that could not be used so far."""
        return len(self._failed)

    @property
    def reason(self) -> str:
        """What is wrong with the first of them, whichever thread saw it first."""
        return self._failed[min(self._failed)] if self._failed else ""

    def guarded(self, image: RgbdImage) -> RgbdImage:
        """The image, whose parts decode as late as before, and never raise."""
        shape = image.camera.height, image.camera.width
        return replace(
            image,
            colour=self._guarded(image.colour, shape),
            depth=self._guarded(image.depth, shape),
        )

    def sound(self, image: RgbdImage) -> RgbdImage | None:
        """The guarded image, its parts known to decode; None where one cannot be had."""
        colour, depth = (_tried(part, image.camera) for part in (image.colour, image.depth))
        for part in (colour, depth):
            if part is not None and _key(part) in self._failed:
                return None
        return replace(image, colour=colour, depth=depth)

    def _guarded(self, message: ImageMessage | None, shape: tuple[int, int]) -> ImageMessage | None:
        if message is None:
            return None
        return replace(message, pixels=partial(self._pixels, message, shape))

    def _pixels(self, message: ImageMessage, shape: tuple[int, int]) -> NDArray[Any]:
        try:
            cells = message.pixels()
            if _fits(cells.shape[:2], shape, depth=message.is_depth):
                return cells
            (height, width), (rows, columns) = cells.shape[:2], shape
            reason = f"{width} x {height} pixels instead of {columns} x {rows}"
        except LogError as error:
            reason = str(error)
        self._failed[_key(message)] = reason
        return np.zeros(shape, np.float32) if message.is_depth else np.zeros((*shape, 3), np.uint8)


def _fits(found: tuple[int, ...], wanted: tuple[int, int], *, depth: bool) -> bool:
    """Depth may be smaller than the colour image by a whole factor."""
    if not depth or not min(found):
        return found == wanted
    return found[0] * wanted[1] == found[1] * wanted[0] and wanted[0] % found[0] == 0


def _tried(message: ImageMessage | None, camera: CameraModel) -> ImageMessage | None:
    """The image, known to decode: as it came where an eighth of a JPEG decodes, or the checksums
    of depth's PNG are right; else decoded once for all.
    """
    from mapmyworld.registration.image_levels import decodes, is_whole_png

    if message is None:
        return None
    is_sound = is_whole_png if message.is_depth else decodes
    return message if is_sound(message, (camera.height, camera.width)) else decoded(message)


def decoded(message: ImageMessage | None) -> ImageMessage | None:
    """The image with its pixels decoded now: whoever asks for them again has them."""
    if message is None:
        return None
    cells = message.pixels()
    return replace(message, pixels=lambda: cells)


def _key(message: ImageMessage) -> tuple[bool, str, int]:
    return message.is_depth, message.frame_id, message.stamp_ns
