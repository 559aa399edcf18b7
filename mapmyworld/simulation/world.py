"""A world: solids on a floor, where the robot starts, and the ways it may be driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapmyworld.simulation.solids import (
    GLASS,
    Box,
    Extent,
    Faces,
    Post,
    box_faces,
    floor_faces,
    merge_faces,
    post_faces,
)
from mapmyworld.types import Mesh


@dataclass(frozen=True, slots=True)
class Ground:
    """A rectangle of floor, with a ceiling above it where there is one."""

    extent: Extent
    floor: str
    ceiling: str = ""
    """Texture; empty = open sky."""
    height: float = 2.5


@dataclass(frozen=True, slots=True)
class World:
    """The origin is where the default route starts, the x axis the way the robot looks there."""

    name: str
    about: str
    solids: tuple[Box | Post, ...]
    grounds: tuple[Ground, ...]
    routes: Mapping[str, str] = field(default_factory=dict)
    """Name -> route, as `mapmyworld.simulation.route` reads it; "default" is one lap."""
    laps: int = 1
    """Of the default route."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Triangles of a world or of a user's mesh, ready for ray casting."""

    faces: Faces
    glass: NDArray[np.bool_]
    """(T,) whether a triangle is glass: invisible to the camera, uncertain to the laser."""
    colours: NDArray[np.uint8] | None = None
    """(T, 3, 3) RGB of each corner, instead of textures."""

    def mesh(self) -> Mesh:
        """All that is solid, as a mesh, in plain colours where the scene brings its own."""
        corners = self.faces.corners[~self.glass].astype(np.float32)
        triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
        colours = None if self.colours is None else self.colours[~self.glass].reshape(-1, 3)
        return Mesh(corners.reshape(-1, 3), triangles, colours)


def build_scene(world: World) -> Scene:
    """The triangles of a world's description."""
    parts = [box_faces(s) if isinstance(s, Box) else post_faces(s) for s in world.solids]
    for ground in world.grounds:
        parts.append(floor_faces(ground.extent, 0.0, ground.floor, up=True))
        if ground.ceiling:
            parts.append(floor_faces(ground.extent, ground.height, ground.ceiling, up=False))
    faces = merge_faces(parts)
    return Scene(faces, np.array([name == GLASS for name in faces.texture]))


def scene_from_mesh(mesh: Mesh) -> Scene:
    """A user's mesh as a scene, in the colours of its vertices."""
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    count = len(corners)
    faces = Faces(corners, np.zeros((count, 3, 2)), np.zeros(count, np.bool_), ("mesh",) * count)
    colours = mesh.colours
    if colours is None:
        colours = np.full((len(mesh.vertices), 3), 180, np.uint8)
    return Scene(faces, np.zeros(count, np.bool_), colours[mesh.triangles])
