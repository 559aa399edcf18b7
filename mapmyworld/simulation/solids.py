"""What worlds are made of: boxes, walls with openings, round posts and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array

Extent = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max, metres."""


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box, turned about the vertical."""

    x: float
    y: float
    length: float  # m along its own x axis
    width: float  # m along its own y axis
    bottom: float  # m above the floor
    top: float
    texture: str
    yaw_deg: float = 0.0
    run: float = 0.0
    """Where along the wall the texture starts, so that it continues from piece to piece."""
    stretch: bool = False
    """Whether each face shows the texture once, instead of repeating it at its own size."""


@dataclass(frozen=True, slots=True)
class Post:
    """An upright prism of many sides."""

    x: float
    y: float
    radius: float
    bottom: float
    top: float
    texture: str
    sides: int = 16


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall: a door by default, a window when `bottom` is above the floor."""

    at: float
    """Metres from the wall's start to the middle of the opening."""
    width: float = 0.9
    bottom: float = 0.0
    top: float = 2.0
    glass: bool = False


def wall(
    start: tuple[float, float],
    end: tuple[float, float],
    texture: str,
    openings: Sequence[Opening] = (),
    *,
    height: float = 2.5,
    thickness: float = 0.12,
) -> tuple[Box, ...]:
    """A straight wall from `start` to `end`, in pieces around its openings."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    yaw = float(np.degrees(np.arctan2(end[1] - start[1], end[0] - start[0])))
    pieces: list[Box] = []

    def add(begin: float, stop: float, bottom: float, top: float, name: str, thick: float) -> None:
        if stop - begin < 1e-6 or top - bottom < 1e-6:
            return
        middle = (begin + stop) / 2.0 / length
        x = start[0] + middle * (end[0] - start[0])
        y = start[1] + middle * (end[1] - start[1])
        pieces.append(Box(x, y, stop - begin, thick, bottom, top, name, yaw, begin))

    done = 0.0
    for hole in sorted(openings, key=lambda o: o.at):
        left, right = hole.at - hole.width / 2.0, hole.at + hole.width / 2.0
        add(done, left, 0.0, height, texture, thickness)
        add(left, right, 0.0, hole.bottom, texture, thickness)
        add(left, right, hole.top, height, texture, thickness)
        if hole.glass:
            add(left, right, hole.bottom, hole.top, GLASS, 0.01)
        done = right
    add(done, length, 0.0, height, texture, thickness)
    return tuple(pieces)


def walls_around(extent: Extent, texture: str) -> tuple[Box, ...]:
    """Four walls around `x_min, y_min, x_max, y_max`, metres, from the lower left corner on."""
    x0, y0, x1, y1 = extent
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))
    return tuple(box for a, b in pairwise(corners) for box in wall(a, b, texture))


GLASS = "glass"  # the texture's name that lets light, and most laser beams, through


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """Triangles with their textures, as parallel arrays."""

    corners: Array
    """(T, 3, 3) metres, counter-clockwise seen from outside."""
    uv: Array
    """(T, 3, 2) metres along the texture, or shares of it where negative widths are absent."""
    stretched: NDArray[np.bool_]
    """(T,) whether `uv` counts the texture's own width and height as one."""
    texture: tuple[str, ...]
    """Name of each triangle's texture."""


def box_faces(box: Box) -> Faces:
    """The twelve triangles of a box."""
    half_l, half_w = box.length / 2.0, box.width / 2.0
    outline = np.array([[-half_l, -half_w], [half_l, -half_w], [half_l, half_w], [-half_l, half_w]])
    yaw = np.radians(box.yaw_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    placed = outline @ turn.T + [box.x, box.y]
    return _prism(placed, box.bottom, box.top, box.texture, box.run, box.stretch)


def post_faces(post: Post) -> Faces:
    """The sides and both ends of a post."""
    angle = 2.0 * np.pi * np.arange(post.sides) / post.sides
    outline = np.stack([np.cos(angle), np.sin(angle)], axis=1) * post.radius + [post.x, post.y]
    return _prism(outline, post.bottom, post.top, post.texture, 0.0, stretch=False)


def floor_faces(extent: Extent, height: float, texture: str, *, up: bool) -> Faces:
    """A horizontal sheet over `x_min, y_min, x_max, y_max`, seen from above or from below."""
    x0, y0, x1, y1 = extent
    outline = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return _sheet(outline if up else outline[::-1], height, texture, stretch=False)


def _prism(
    outline: Array, bottom: float, top: float, texture: str, run: float, stretch: bool
) -> Faces:
    parts = [
        _sheet(outline, top, texture, stretch),
        _sheet(outline[::-1], bottom, texture, stretch),
    ]
    for index in range(len(outline)):
        a, b = outline[index], outline[(index + 1) % len(outline)]
        corners = np.array([[*a, bottom], [*b, bottom], [*b, top], [*a, top]])
        length = float(np.hypot(*(b - a)))
        if stretch:
            uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        else:
            # On the far side of a wall the texture runs backwards from the same start.
            first = run if index != 2 else run + length
            step = length if index != 2 else -length
            uv = np.array(
                [[first, bottom], [first + step, bottom], [first + step, top], [first, top]]
            )
        fan = [[0, 1, 2], [0, 2, 3]]
        parts.append(Faces(corners[fan], uv[fan], np.full(2, stretch), (texture, texture)))
        run += 0.0 if len(outline) == 4 else length
    return merge_faces(parts)


def _sheet(outline: Array, height: float, texture: str, stretch: bool) -> Faces:
    fan = [[0, i, i + 1] for i in range(1, len(outline) - 1)]
    corners = np.concatenate([outline, np.full((len(outline), 1), height)], axis=1)[fan]
    uv = outline[fan]
    if stretch:
        low, high = outline.min(0), outline.max(0)
        uv = (uv - low) / (high - low)
    return Faces(corners, uv, np.full(len(fan), stretch), (texture,) * len(fan))


def merge_faces(parts: Sequence[Faces]) -> Faces:
    """All triangles of the parts, in their order."""
    return Faces(
        np.concatenate([p.corners for p in parts]),
        np.concatenate([p.uv for p in parts]),
        np.concatenate([p.stretched for p in parts]),
        tuple(name for p in parts for name in p.texture),
    )
