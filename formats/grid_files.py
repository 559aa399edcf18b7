"""Occupancy grids as PGM (or PNG) + YAML, by the rules of Nav2's map_server and map_saver."""

from __future__ import annotations

import math
import os
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from formats.bounds import FARTHEST
from formats.picture_files import encoded_file
from formats.whole_files import read_whole, write_whole
from mapmyworld.errors import MapError
from mapmyworld.types import OccupancyGrid

Mode = Literal["trinary", "scale", "raw"]
_OCCUPIED, _FREE, _UNKNOWN = 0, 254, 205
_GREY = np.full(256, _UNKNOWN, np.uint8)  # of a trinary cell
_GREY[[0, 100]] = _FREE, _OCCUPIED
_MAX_CELLS = 1 << 28
# Pillow's names of pixels up to 8 bits -> of the same with alpha.
_WITH_ALPHA = {"1": "LA", "L": "LA", "LA": "LA", "P": "RGBA", "RGB": "RGBA", "RGBA": "RGBA"}
_MOST_PACKED = 8 * 1032  # cells of one bit in a byte of a PNG; deflate packs up to 1032 to 1


def write_grid(stem: Path, grid: OccupancyGrid, mode: Mode = "trinary") -> tuple[Path, Path]:
    """Writes `stem`.pgm (scale mode: .png) and `stem`.yaml; returns their paths."""
    image, description = grid_files(stem, mode)
    if mode == "scale":
        grey, alpha = np.moveaxis(_scaled(grid), 2, 0)
        write_whole(image, encoded_file(".png", np.dstack([grey, grey, grey, alpha])))
    else:
        cells = (grid.trinary() if mode == "trinary" else _raw(grid)).view(np.uint8)[::-1]
        _write_pgm(image, _GREY[cells] if mode == "trinary" else cells, grid.resolution)
    write_whole(description, _yaml(image.name, grid, mode))
    return image, description


def grid_files(stem: Path, mode: Mode = "trinary") -> tuple[Path, Path]:
    """The picture and the YAML that `write_grid` writes."""
    image = stem.with_name(stem.name + (".png" if mode == "scale" else ".pgm"))
    return image, stem.with_name(stem.name + ".yaml")


def _raw(grid: OccupancyGrid) -> NDArray[np.int8]:
    """The cell values themselves, 0 to 100; unknown is -1, which a byte holds as 255."""
    probability = grid.probabilities()
    known = np.isfinite(probability)
    cells = np.full(probability.shape, -1, np.int8)
    cells[known] = np.rint(100.0 * probability[known]).astype(np.int8)
    return cells


def _scaled(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Grey and alpha (H, W, 2), top row first: lightness is freedom, unknown is transparent."""
    probability = grid.probabilities()
    known = np.isfinite(probability)
    picture = np.zeros((*probability.shape, 2), np.uint8)
    picture[known, 0] = np.rint(255.0 * (1.0 - probability[known])).astype(np.uint8)
    picture[..., 1] = np.where(known, 255, 0)
    return picture[::-1]


def _write_pgm(path: Path, grey: NDArray[np.uint8], resolution: float) -> None:
    height, width = grey.shape
    head = f"P5\n# CREATOR: mapmyworld {resolution:.3f} m/pix\n{width} {height}\n255\n"
    write_whole(path, b"".join((head.encode(), np.ascontiguousarray(grey).data)))


def _yaml(image: str, grid: OccupancyGrid, mode: Mode) -> str:
    """Numbers as short as they can be while reading back exactly."""
    x, y = (float(value) for value in grid.origin)
    return (
        f"image: {image}\n"
        f"mode: {mode}\n"
        f"resolution: {float(grid.resolution)!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OccupancyGrid.occupied_threshold}\n"
        f"free_thresh: {OccupancyGrid.free_threshold}\n"
    )


def read_grid(path: Path) -> OccupancyGrid:
    """The grid of a YAML file by map_server's rules.

    Its picture must lie in the YAML's folder or below: a YAML from a stranger must not choose which
    files are opened.

    Trinary cells come back as the log-odds of 0.95, 0.05 and NaN, so that `trinary()` gives what a
    robot would load; scaled and raw ones as the log-odds of their probability. Raises `MapError`
    where there is none, or a damaged one.
    """
    keys = _read_keys(path)
    mode = keys.get("mode", "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise MapError(f"{path}: mode {mode!r} is none of trinary, scale, raw")
    picture = _read_picture(_picture_path(path, keys["image"]))
    occupied, free = _number(path, keys, "occupied_thresh"), _number(path, keys, "free_thresh")
    negate = keys["negate"].lower() in ("1", "true")
    probability = _probabilities(picture, mode, negate, occupied, free)
    origin = _origin(path, keys["origin"])
    with np.errstate(divide="ignore"):
        log_odds = np.log(probability) - np.log1p(-probability)
    resolution = _number(path, keys, "resolution")
    if not resolution > 0:
        raise MapError(f"{path}: resolution {resolution} is not a positive number of metres")
    ascending = np.ascontiguousarray(log_odds[::-1], np.float32)
    return OccupancyGrid(ascending, resolution, origin)


def same_grid(path: Path, grid: OccupancyGrid, mode: Mode) -> int:
    """How many cells a robot would load differently from what we hold."""
    read = read_grid(path)
    if mode == "trinary":
        return int(np.count_nonzero(read.trinary() != grid.trinary()))
    ours, theirs = grid.probabilities(), read.probabilities()
    if mode == "scale":  # map_server itself rounds what lies beyond the thresholds
        ends = grid.free_threshold, grid.occupied_threshold
        ours, theirs = (np.clip(p, *ends) for p in (ours, theirs))
    return int(np.count_nonzero(~np.isclose(ours, theirs, rtol=0, atol=0.006, equal_nan=True)))


def _probabilities(
    picture: NDArray[np.uint8], mode: str, negate: bool, occupied: float, free: float
) -> NDArray[np.float64]:
    """Occupancy (H, W), top row first; NaN = unknown."""
    grey, alpha = picture[..., :-1].mean(axis=2), picture[..., -1]
    if mode == "raw":
        return np.where(grey <= 100, np.clip(grey / 100.0, 1e-6, 1 - 1e-6), np.nan)
    p = grey / 255.0 if negate else (255.0 - grey) / 255.0
    between = np.nan if mode == "trinary" else np.clip(p, 1e-6, 1 - 1e-6)
    cells = np.where(p >= occupied, 0.95, np.where(p <= free, 0.05, between))
    return np.where(alpha < 255, np.nan, cells)


def _read_keys(path: Path) -> dict[str, str]:
    text = os.fsdecode(read_whole(path))  # names of files, in whatever locale
    keys: dict[str, str] = {}
    key = ""
    for line in text.splitlines():
        words = line.partition("#")[0].strip()
        name, colon, value = words.partition(":")
        if colon:
            key = name.strip()
            keys[key] = value.strip().strip("'\"")
        elif key and words.startswith("- "):  # a list, one value a line
            keys[key] += ("," if keys[key] else "") + words[2:].strip()
    needed = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")
    absent = [name for name in needed if name not in keys]
    if absent:
        raise MapError(f"{path}: lacks {', '.join(absent)}, which map_server requires")
    return keys


def _number(path: Path, keys: dict[str, str], name: str) -> float:
    try:
        number = float(keys[name])
    except ValueError:
        raise MapError(f"{path}: {name}: {keys[name]!r} is not a number") from None
    if not math.isfinite(number):
        raise MapError(f"{path}: {name}: {number} is not a finite number")
    return number


def _origin(path: Path, text: str) -> NDArray[np.float64]:
    try:
        x, y, yaw = (float(part) for part in text.strip("[] ").split(","))
    except ValueError:
        raise MapError(f"{path}: origin: {text!r} is not [x, y, yaw]") from None
    if not (math.isfinite(x) and math.isfinite(y) and max(abs(x), abs(y)) < FARTHEST):
        raise MapError(f"{path}: origin: {text!r} is out of range: correct the YAML")
    if yaw != 0.0:
        raise MapError(f"{path}: a grid turned by {yaw} rad cannot be read: turn it to yaw 0")
    return np.array([x, y])


def _picture_path(path: Path, name: str) -> Path:
    try:
        folder, picture = path.parent.resolve(), (path.parent / name).resolve()
    except (OSError, ValueError) as error:  # a loop of links, a zero byte
        raise MapError(f"{path}: image: {name!r} is no name of a file ({error})") from None
    if not picture.is_relative_to(folder):
        raise MapError(f"{path}: image: {name!r} lies outside its folder: put it beside the YAML")
    if picture.exists() and not picture.is_file():
        raise MapError(f"{path}: image: {name!r} is no file: a folder, a device or a pipe")
    return picture


def _read_picture(path: Path) -> NDArray[np.uint8]:
    """Channels and alpha (H, W, C + 1), top row first."""
    from PIL.PngImagePlugin import PngImageFile
    from PIL.PpmImagePlugin import PpmImageFile

    data = read_whole(path)
    try:
        picture = (PpmImageFile if data.startswith(b"P") else PngImageFile)(BytesIO(data))
        width, height = picture.size
        if width * height > min(_MAX_CELLS, _MOST_PACKED * len(data)):
            raise ValueError(f"{width} x {height} cells in {len(data)} bytes")
        if picture.mode not in _WITH_ALPHA:
            raise ValueError(f"its pixels are {picture.mode}, not of 8 bits")
        return np.asarray(picture.convert(_WITH_ALPHA[picture.mode]))
    except Exception as error:  # a damaged file may end in any of Python's errors
        raise MapError(f"{path}: is no PGM or PNG that can be read ({error})") from None
