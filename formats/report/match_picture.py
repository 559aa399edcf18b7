"""Pictures of what the eyes of the map saw: images for a page, features, matches of a pair."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.picture_files import encoded_file
from formats.report.contents import NodePicture
from formats.report.map_axes import WIDTH, caption, draw_lines, figure_file
from mapmyworld.types import Features, ImageMessage

Picture = NDArray[np.uint8]
_DEEP, _SHALLOW = "#ffc800", "#969696"  # features with depth and without
_AGREED, _OUTLIER = "#00c850", "#e63c32"
_QUALITY = 70  # of the JPEG of a node's image
_GAP = 8  # pixels between two pictures side by side


def node_picture(image: ImageMessage, width: int) -> NodePicture:
    """A node's image, at most `width` pixels across, as JPEG: pages are mailed."""
    pixels = np.asarray(image.pixels(), np.uint8)
    scale = min(1.0, width / pixels.shape[1])
    size = round(scale * pixels.shape[1]), max(1, round(scale * pixels.shape[0]))
    small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    blue_first = small if small.ndim == 2 else small[:, :, ::-1]
    data = encoded_file(".jpg", blue_first, cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
    return NodePicture(data, *size, scale)


def write_features_picture(path: Path, picture: Picture, features: Features | None) -> None:
    """A node's image, grey (H, W) or colour (H, W, 3), with circles of its features' sizes."""
    from matplotlib.collections import EllipseCollection

    with _drawn(path, picture) as axes:
        if features is None:
            return
        deep = np.isfinite(features.points[:, 2])
        across = np.clip(features.sizes / 3.0, 4.0, 40.0)
        look: Any = {"units": "xy", "offset_transform": axes.transData, "facecolors": "none"}
        colours = np.where(deep, _DEEP, _SHALLOW)
        look |= {"offsets": features.pixels, "edgecolors": colours, "linewidths": 0.6}
        axes.add_collection(EllipseCollection(across, across, np.zeros(len(across)), **look))
        axes.set_title(f"{len(deep)} features, {int(deep.sum())} with depth")


def write_match_picture(
    path: Path,
    pictures: tuple[Picture, Picture],
    pixels_a: NDArray[np.float32],
    pixels_b: NDArray[np.float32],
    agreed: NDArray[np.bool_],
    text: str,
) -> None:
    """Two images side by side with their matches: green agree, red do not.

    The images are grey (H, W) or colour (H, W, 3), RGB; the matches are at `pixels_a` and
    `pixels_b` (M, 2), and `agreed` (M,).
    """
    shift = np.array([pictures[0].shape[1] + _GAP, 0], np.float32)
    ends = np.stack([pixels_a, pixels_b + shift], axis=1)
    with _drawn(path, *pictures) as axes:
        for which, colour in ((~agreed, _OUTLIER), (agreed, _AGREED)):  # agreeing ones on top
            draw_lines(axes, ends[which], colour, "", 0.4)
            axes.plot(*ends[which].reshape(-1, 2).T, "o", mec=colour, mfc="none", ms=2, mew=0.4)
        count = f"{len(agreed)} matches, {int(np.count_nonzero(agreed))} agree"
        axes.set_title(f"{count}. {caption(text)}", wrap=True)


@contextmanager
def _drawn(path: Path, *pictures: Picture) -> Iterator[Any]:
    """Axes in the pixels of the first picture, the others to the right of it."""
    starts = np.cumsum([0, *(picture.shape[1] + _GAP for picture in pictures)]) - 0.5
    height, width = max(len(picture) for picture in pictures), starts[-1] + 0.5 - _GAP
    with figure_file(path, WIDTH * height / width) as figure:
        axes = figure.subplots()
        for picture, left in zip(pictures, starts, strict=False):
            extent = (left, left + picture.shape[1], len(picture) - 0.5, -0.5)
            axes.imshow(picture, cmap="gray", vmin=0, vmax=255, extent=extent)
        axes.axis((-0.5, width - 0.5, height - 0.5, -0.5))
        axes.axis("off")
        yield axes
