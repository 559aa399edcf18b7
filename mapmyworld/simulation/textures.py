"""Procedural textures by name: the same name always looks the same."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import WorldError

EDGE = 256  # texels, of every texture
_LEVELS = 8  # from EDGE down to 2 texels
Picture = NDArray[np.float64]
_ROWS, _COLUMNS = np.mgrid[0:EDGE, 0:EDGE]

_PLAIN = {
    "white": (236, 236, 232),
    "cream": (226, 219, 201),
    "grey": (150, 150, 152),
}


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A picture that covers a surface again and again."""

    pixels: NDArray[np.uint8]
    """(EDGE, EDGE, 3) RGB, row 0 at the bottom."""
    width: float
    """Metres that one repeat covers."""
    height: float


def make_texture(name: str) -> Texture:
    """The texture "kind" or "kind:variant"; raises `WorldError` for a kind that does not exist."""
    kind, _, variant = name.partition(":")
    if kind == "plain":
        if variant not in _PLAIN:
            raise WorldError(f"texture {name!r}: plain comes in {', '.join(_PLAIN)}")
        return Texture(_bytes(np.ones((EDGE, EDGE, 1)) * np.array(_PLAIN[variant])), 1.0, 1.0)
    if kind not in _KINDS:
        known = ", ".join(["plain", *_KINDS])
        raise WorldError(f"there is no texture {name!r}: kinds are {known}")
    paint, width, height = _KINDS[kind]
    random = np.random.default_rng(zlib.crc32(name.encode()))
    return Texture(_bytes(paint(random)), width, height)


@dataclass(frozen=True, slots=True, eq=False)
class TextureSet:
    """Textures with all their coarser levels in one array."""

    texels: NDArray[np.uint8]
    """(N, 3)."""
    offsets: NDArray[np.int64]
    """(T, L) of T textures and L levels: where each begins in `texels`."""
    textures: tuple[Texture, ...]


def texture_set(names: tuple[str, ...]) -> TextureSet:
    """The named textures, each averaged down level by level (mip maps)."""
    textures = tuple(make_texture(name) for name in names)
    parts: list[NDArray[np.uint8]] = []
    offsets = np.zeros((len(names), _LEVELS), np.int64)
    place = 0
    for index, texture in enumerate(textures):
        level = texture.pixels.astype(np.float64)
        for depth in range(_LEVELS):
            offsets[index, depth] = place
            parts.append(_bytes(level).reshape(-1, 3))
            place += len(parts[-1])
            level = level.reshape(len(level) // 2, 2, -1, 2, 3).mean(axis=(1, 3))
    return TextureSet(np.concatenate(parts), offsets, textures)


def _bytes(picture: Picture) -> NDArray[np.uint8]:
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


def _cloudy(random: np.random.Generator, cells: int) -> Picture:
    """(EDGE, EDGE) smooth noise of zero mean that joins at its borders."""
    coarse = random.normal(size=(cells, cells))
    place = np.arange(EDGE) * cells / EDGE
    low = place.astype(int)
    share = place - low
    share = share * share * (3.0 - 2.0 * share)
    high = (low + 1) % cells
    rows = coarse[low] * (1 - share)[:, None] + coarse[high] * share[:, None]
    return np.asarray(rows[:, low] * (1 - share) + rows[:, high] * share)


def _tinted(base: tuple[int, int, int], shade: Picture) -> Picture:
    return np.asarray(np.array(base) * (1.0 + shade[..., None]))


def _masonry(
    random: np.random.Generator, rows: int, columns: int, base: tuple[int, int, int], tone: float
) -> Picture:
    """Blocks of differing tone with light joints, every other row shifted by half a block."""
    tones = random.normal(size=(rows, columns)) * tone
    y = np.arange(EDGE) * rows / EDGE
    row = y.astype(int)
    shift = 0.5 * (row % 2)[:, None]
    x = (np.arange(EDGE)[None, :] * columns / EDGE + shift) % columns
    column = x.astype(int)
    picture = _tinted(base, tones[row[:, None], column] + 0.03 * _cloudy(random, 64))
    joint = ((y - row) < 0.12)[:, None] | ((x - column) < 0.06)
    picture[joint] = (198, 194, 186)
    return picture


def _tiles(random: np.random.Generator) -> Picture:
    tone = random.uniform(140, 215, 3)
    return _masonry(random, 6, 6, (int(tone[0]), int(tone[1]), int(tone[2])), 0.08)


def _planks(random: np.random.Generator) -> Picture:
    picture = _masonry(random, 8, 2, (166, 122, 76), 0.12)
    grain = np.repeat(random.normal(size=(EDGE, 32)) * 0.06, EDGE // 32, axis=1)
    return np.asarray(picture * (1.0 + grain[..., None]))


def _wood(random: np.random.Generator) -> Picture:
    rings = np.sin(40.0 * np.arange(EDGE)[:, None] / EDGE + 3.0 * _cloudy(random, 6))
    return _tinted((132, 88, 52), 0.12 * rings + 0.04 * _cloudy(random, 64))


def _rough(base: tuple[int, int, int], fine: float, coarse: float) -> Callable[..., Picture]:
    def paint(random: np.random.Generator) -> Picture:
        shade = fine * _cloudy(random, 128) + coarse * _cloudy(random, 12)
        return _tinted(base, shade)

    return paint


def _wallpaper(random: np.random.Generator) -> Picture:
    """A pale wall with a sparse print of blossoms, none quite like the other."""
    base = random.uniform(190, 230, 3)
    picture = np.ones((EDGE, EDGE, 3)) * base
    for _ in range(26):
        cx, cy, radius = *random.uniform(0, EDGE, 2), random.uniform(4, 10)
        dx = (_COLUMNS - cx + EDGE / 2) % EDGE - EDGE / 2
        dy = (_ROWS - cy + EDGE / 2) % EDGE - EDGE / 2
        petals = radius * (1.0 + 0.4 * np.cos(random.integers(3, 7) * np.arctan2(dy, dx)))
        picture[np.hypot(dx, dy) < petals] = random.uniform(60, 190, 3)
    return picture


def _fabric(random: np.random.Generator) -> Picture:
    base = random.uniform(60, 170, 3)
    weave = 0.12 * np.sign(np.sin(_COLUMNS * np.pi / 16)) * np.sign(np.sin(_ROWS * np.pi / 16))
    shade = weave + 0.10 * _cloudy(random, 32)
    return np.asarray(base * (1.0 + shade[..., None]))


def _books(random: np.random.Generator) -> Picture:
    """Shelves of spines, each its own colour and height, some with a label."""
    picture = np.ones((EDGE, EDGE, 3)) * 46.0
    shelf = EDGE // 4
    for row in range(4):
        x = 0
        while x < EDGE:
            width = int(random.integers(5, 14))
            height = int(shelf * random.uniform(0.6, 0.92))
            spine = picture[row * shelf + 3 : row * shelf + height, x : x + width]
            spine[:] = random.uniform(30, 235, 3)
            label = height // 2
            if random.random() < 0.6:
                spine[label : label + 5, 1:-1] = random.uniform(170, 250, 3)
            x += width + 1
        picture[row * shelf : row * shelf + 3] = (120, 86, 50)
    return picture


def _picture(random: np.random.Generator) -> Picture:
    """A framed painting: fields, discs and strokes, unmistakable."""
    picture = np.ones((EDGE, EDGE, 3)) * random.uniform(80, 220, 3)
    for _ in range(45):
        left, low = random.integers(0, EDGE - 12, 2)
        width, height = random.integers(8, EDGE // 3, 2)
        picture[low : low + height, left : left + width] = random.uniform(10, 245, 3)
    for _ in range(35):
        cx, cy = random.uniform(0, EDGE, 2)
        disc = np.hypot(_COLUMNS - cx, _ROWS - cy) < random.uniform(4, 20)
        picture[disc] = random.uniform(10, 245, 3)
    frame = np.minimum.reduce([_COLUMNS, _ROWS, EDGE - 1 - _COLUMNS, EDGE - 1 - _ROWS]) < 8
    picture[frame] = random.uniform(20, 90, 3)
    return picture


def _leaves(random: np.random.Generator) -> Picture:
    picture = _rough((52, 104, 48), 0.25, 0.15)(random)
    for _ in range(90):
        cx, cy, turn = *random.uniform(0, EDGE, 2), random.uniform(0, np.pi)
        along = (_COLUMNS - cx) * np.cos(turn) + (_ROWS - cy) * np.sin(turn)
        across = (_ROWS - cy) * np.cos(turn) - (_COLUMNS - cx) * np.sin(turn)
        leaf = (along / 16) ** 2 + (across / 6) ** 2 < 1.0
        picture[leaf] = np.array([60, 130, 55]) * random.uniform(0.5, 1.5)
    return picture


# Kind -> painter, width and height in metres of one repeat.
_KINDS: dict[str, tuple[Callable[[np.random.Generator], Picture], float, float]] = {
    "picture": (_picture, 1.0, 1.0),
    "brick": (lambda random: _masonry(random, 16, 6, (158, 84, 62), 0.16), 1.5, 1.2),
    "tiles": (_tiles, 1.8, 1.8),
    "planks": (_planks, 2.4, 1.2),
    "wood": (_wood, 0.8, 0.8),
    "carpet": (_rough((112, 116, 130), 0.10, 0.05), 2.0, 2.0),
    "concrete": (_rough((158, 156, 150), 0.05, 0.10), 2.5, 2.5),
    "marble": (_rough((206, 204, 200), 0.02, 0.12), 1.2, 1.2),
    "terracotta": (_rough((176, 98, 66), 0.06, 0.08), 0.8, 0.8),
    "fabric": (_fabric, 0.8, 0.8),
    "wallpaper": (_wallpaper, 1.7, 1.7),
    "books": (_books, 1.2, 1.4),
    "leaves": (_leaves, 0.9, 0.9),
}
