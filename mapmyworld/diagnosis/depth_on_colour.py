"""Whether a camera's depth lies on its colours: edges of both, moved until they overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.diagnosis.finding import Finding
from mapmyworld.geometry import Array
from mapmyworld.types import RgbdImage

_WIDTH = 320  # pixels to which images are reduced
_REACH = 16  # pixels of these by which depth may be shifted
_COARSE = np.arange(-_REACH, _REACH + 1, 2)
_SCALES = np.arange(0.88, 1.121, 0.03)
_ARM = 4  # pixels between the four places that distinguish a jump from a slope
_JUMP = 0.02  # 1/m, what a jump in inverse depth is at least; a Kinect's noise is a tenth of it,
_JUMP_SHARE = 0.1  # and of the nearer side
_STEEPER = 3.0  # times as much as on both sides of it
_LEAST_EDGES = 30  # pixels, for an image to count
_MOST_EDGES = 400  # of an image and direction that are looked at
_LEAST_IMAGES = 4
_OFF = 0.01  # of the image's width, from which it is worth a word
_GAIN = 1.1  # times as much overlap as unmoved, for a scale or a shift to be believed
_DISAGREE = 3.0  # reduced pixels by which half of the images may differ from the other half,
_DISAGREE_SHARE = 0.5  # or this much of what is found


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """An image's jumps of depth, and how much its grey changes at every place, along one axis."""

    rows: NDArray[np.int64]
    """(J,) of the jumps."""
    columns: NDArray[np.int64]
    """(J,) of the jumps."""
    change: Array
    """(H, W) from 0 to 1."""


@dataclass(frozen=True, slots=True)
class Displacement:
    """Depth lies `scale` times as far from the middle as colour, and so far beside it."""

    scale: float
    across: float
    down: float
    reach: float
    """Half the image's width; all in one unit of pixels."""

    @property
    def size(self) -> float:
        """The most by which a pixel is off."""
        return float(np.hypot(self.across, self.down) + abs(self.scale - 1.0) * self.reach)

    def differs(self, other: Displacement) -> float:
        """The most by which two displacements put a pixel at different places."""
        shift = np.hypot(self.across - other.across, self.down - other.down)
        return float(shift + abs(self.scale - other.scale) * self.reach)


def alignment_findings(images: Sequence[RgbdImage]) -> Iterator[Finding]:
    """By how many pixels edges of depth lie beside edges of colour, if the images agree on it."""
    seen = [edges for image in images if (edges := image_edges(image)) is not None]
    if len(seen) < _LEAST_IMAGES:
        return
    coarse = coarse_overlaps(seen)
    parts = (slice(None), slice(0, None, 2), slice(1, None, 2))
    found, *halves = (displacement(seen[part], coarse[part]) for part in parts)
    allowed = max(_DISAGREE, _DISAGREE_SHARE * found.size)
    if halves[0].differs(halves[1]) > allowed:
        return
    pixels = images[0].camera.width / (2.0 * found.reach)
    size = found.size * pixels
    good = size < _OFF * images[0].camera.width
    suggestion = "register depth to colour (depth_registration), or calibrate the pair"
    text = (
        f"depth is shifted by {found.across * pixels:+.0f}, {found.down * pixels:+.0f} pixels "
        f"against colour and scaled by {found.scale:.2f} ({len(seen)} images)"
    )
    yield Finding("camera and depth", size, "pixels", good, text, suggestion)


def coarse_overlaps(images: Sequence[tuple[Edges, Edges]]) -> Array:
    """Overlaps (N, K, S, S) of each image at every scale, looked at by all and by halves."""
    tried = [[_overlap(axes, scale, _COARSE) for scale in (*_SCALES, 1.0)] for axes in images]
    return np.array(tried)


def displacement(images: Sequence[tuple[Edges, Edges]], coarse: Array) -> Displacement:
    """That at which most change of grey lies on the jumps of depth of all N images.

    `coarse` (N, K, S, S) as of `coarse_overlaps`.
    """
    *scaled, unscaled = coarse.sum(axis=0).max(axis=(1, 2)).tolist()
    chosen = int(np.argmax(scaled))
    best = float(_SCALES[chosen]) if scaled[chosen] >= _GAIN * unscaled else 1.0
    shifts = np.arange(-_REACH, _REACH + 1)
    window = np.sum([_overlap(axes, best, shifts) for axes in images], axis=0)
    if window.max() < _GAIN * window[_REACH, _REACH]:  # edges of one direction leave the other open
        window[_REACH, _REACH] = np.inf
    row, column = np.unravel_index(int(window.argmax()), window.shape)
    half = images[0][0].change.shape[1] / 2.0
    across, down = float(-shifts[column]), float(-shifts[row])
    return Displacement(1.0 / best, across / best, down / best, half)


def _overlap(axes: tuple[Edges, Edges], scale: float, shifts: NDArray[np.int64]) -> Array:
    """Change of grey (S, S) at jumps of depth scaled about the middle, then shifted."""
    count = sum(len(edges.rows) for edges in axes)
    return np.asarray(sum(_change_at(edges, scale, shifts) for edges in axes) / np.sqrt(count))


def _change_at(edges: Edges, scale: float, shifts: NDArray[np.int64]) -> Array:
    """The sum (S, S) of change at an image's jumps, scaled about the middle, then shifted."""
    height, width = edges.change.shape
    border = 2 * _REACH
    flat, wide = np.pad(edges.change, border).ravel(), width + 2 * border
    rows = np.rint((edges.rows - height / 2) * scale + height / 2).astype(np.int64)
    columns = np.rint((edges.columns - width / 2) * scale + width / 2).astype(np.int64)
    rows = np.clip(rows, -_REACH, height + _REACH - 1) + border
    columns = np.clip(columns, -_REACH, width + _REACH - 1) + border
    moves = shifts[:, None] * wide + shifts
    return np.stack([flat[(rows * wide + columns) + row[:, None]].sum(axis=1) for row in moves])


def image_edges(image: RgbdImage) -> tuple[Edges, Edges] | None:
    """Edges up and down, and across; None where there are too few to indicate anything."""
    assert image.colour is not None
    assert image.depth is not None
    grey = grey_levels(image.colour.pixels())
    depth = np.asarray(image.depth.pixels(), np.float32)
    if depth.shape != grey.shape or min(depth.shape) < 8 * _ARM:
        return None
    step = max(1, round(grey.shape[1] / _WIDTH))
    height, width = (side // step for side in grey.shape)
    whole = np.asarray(grey[: height * step, : width * step], np.float32)
    grey = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    depth = depth[: height * step : step, : width * step : step]
    near = cv2.medianBlur(np.where(depth > 0, 1.0 / np.maximum(depth, 1e-3), 0.0), 3)
    found = tuple(_edges(near, grey, axis) for axis in (0, 1))
    return (found[0], found[1]) if sum(len(e.rows) for e in found) >= _LEAST_EDGES else None


def _edges(near: Array, grey: Array, axis: int) -> Edges:
    """Jumps of inverse depth along an axis: on a plane it changes evenly, at any slant."""
    places = np.moveaxis(near, axis, -1)
    count = places.shape[-1] - 3 * _ARM
    a, b, c, d = (places[..., k * _ARM : k * _ARM + count] for k in range(4))
    known = (a > 0) & (b > 0) & (c > 0) & (d > 0)
    jump, slope = np.abs(c - b), np.maximum(np.abs(b - a), np.abs(d - c))
    least = np.maximum(_JUMP, np.maximum(_JUMP_SHARE * np.maximum(b, c), _STEEPER * slope))
    line, place = np.nonzero(known & (jump > least))
    place += 3 * _ARM // 2
    # Not every nth: a jump lies at so many places of its row, of which the same would be taken.
    chosen = np.linspace(0, len(line) - 1, min(len(line), _MOST_EDGES)).astype(np.int64)
    line, place = line[chosen], place[chosen]
    change = np.abs(np.gradient(grey, axis=axis))
    change = change / (change + 2.0 * change.mean() + 1e-9)
    return Edges(*((place, line) if axis == 0 else (line, place)), change)


def grey_levels(picture: NDArray[np.generic]) -> Array:
    """Grey levels (H, W) of a grey picture (H, W), or the mean of the colours of one (H, W, C)."""
    channels = np.atleast_3d(picture)
    return np.asarray(np.einsum("hwc->hw", channels, dtype=np.float64) / channels.shape[2])
