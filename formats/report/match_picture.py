"""Pictures of what the eyes of the map saw: features, and matches of a pair."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import Features

Picture = NDArray[np.uint8]
_FEATURE = (255, 200, 0)  # RGB: features with depth
_SHALLOW = (150, 150, 150)  # without depth
_AGREED = (0, 200, 80)  # matches that agree with the motion
_OUTLIER = (230, 60, 50)
_GAP = 8  # pixels between two pictures side by side
_BAR = 28  # pixels of the line of text below


def features_picture(picture: Picture, features: Features) -> Picture:
    """A node's image with its features: circles of their size, grey without depth.

    Of one in grey (H, W) or colour (H, W, 3), RGB.
    """
    canvas = as_rgb(picture)
    deep = np.isfinite(features.points[:, 2])
    for k in range(len(features.pixels)):
        _mark(canvas, features, k, _FEATURE if deep[k] else _SHALLOW)
    return with_caption(canvas, f"{len(deep)} features, {int(deep.sum())} with depth")


def match_picture(
    picture_a: Picture,
    picture_b: Picture,
    pixels_a: NDArray[np.float32],
    pixels_b: NDArray[np.float32],
    agreed: NDArray[np.bool_],
    caption: str = "",
) -> Picture:
    """Two images side by side with their matches: green agree, red do not.

    `picture_a` and `picture_b` are grey (H, W) or colour (H, W, 3), the result (K, L, 3), all RGB.
    Matches are at `pixels_a` and `pixels_b` (M, 2); `agreed` (M,).
    """
    canvas, shift = side_by_side(as_rgb(picture_a), as_rgb(picture_b))
    order = np.argsort(agreed, kind="stable")  # agreeing ones on top
    for k in order:
        colour = _AGREED if agreed[k] else _OUTLIER
        start = (round(float(pixels_a[k, 0])), round(float(pixels_a[k, 1])))
        end = (round(float(pixels_b[k, 0])) + shift, round(float(pixels_b[k, 1])))
        cv2.line(canvas, start, end, colour, 1, cv2.LINE_AA)
        for point in (start, end):
            cv2.circle(canvas, point, 3, colour, 1, cv2.LINE_AA)
    count = f"{len(agreed)} matches, {int(np.count_nonzero(agreed))} agree"
    return with_caption(canvas, f"{count}. {caption}" if caption else count)


def as_rgb(picture: Picture) -> Picture:
    """A copy (H, W, 3), to draw on, of a picture (H, W) or (H, W, 3)."""
    if picture.ndim == 2:
        return np.repeat(picture[..., None], 3, axis=2).copy()
    return np.ascontiguousarray(picture).copy()


def side_by_side(a: Picture, b: Picture) -> tuple[Picture, int]:
    """Two pictures in one, (H, W, 3) each, and the column at which the second one begins."""
    height = max(a.shape[0], b.shape[0])
    shift = a.shape[1] + _GAP
    canvas = np.full((height, shift + b.shape[1], 3), 255, np.uint8)
    canvas[: a.shape[0], : a.shape[1]] = a
    canvas[: b.shape[0], shift:] = b
    return canvas, shift


def with_caption(picture: Picture, text: str) -> Picture:
    """The picture with a line of text below it, small enough to fit; (H, W, 3) both."""
    bar = np.full((_BAR, picture.shape[1], 3), 255, np.uint8)
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    text = text.encode("ascii", "replace").decode()  # bytes of names that are no text crash OpenCV
    width = cv2.getTextSize(text, font, size, 1)[0][0]
    size *= min(1.0, (picture.shape[1] - 12) / max(width, 1))
    cv2.putText(bar, text, (6, _BAR - 9), font, size, (30, 30, 30), 1, cv2.LINE_AA)
    return np.concatenate([picture, bar])


def _mark(canvas: Picture, features: Features, k: int, colour: tuple[int, int, int]) -> None:
    u, v = (round(float(c)) for c in features.pixels[k])
    radius = max(2, min(round(float(features.sizes[k]) / 6.0), 20))
    cv2.circle(canvas, (u, v), radius, colour, 1, cv2.LINE_AA)
