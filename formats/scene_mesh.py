"""A mesh from PLY, OBJ, GLB and whatever else trimesh reads: a world, or true surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError
from mapmyworld.types import Mesh

SCENE_SUFFIXES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off")
_FARTHEST = 10_000.0  # m from the origin, where a robot could drive
_Y_UP = (".glb", ".gltf")  # formats whose standard says that y points up
_GREY = 180  # of meshes without colours


def read_scene_mesh(path: Path) -> Mesh:
    """The mesh with z up and a colour at each vertex, textures sampled; metres are assumed.

    Raises `MapError` where the file is no mesh.
    """
    if not path.is_file():
        raise MapError(f"{path}: there is no such file")
    vertices, triangles, colours = _arrays(path)
    if len(triangles) == 0 or not np.isfinite(vertices).all():
        raise MapError(f"{path}: holds no triangles that could be surfaces")
    if np.abs(vertices).max() > _FARTHEST:
        raise MapError(f"{path}: reaches beyond {_FARTHEST:.0f} m: export the mesh in metres")
    if path.suffix.lower() in _Y_UP:
        vertices = vertices @ np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    return Mesh(vertices.astype(np.float32), triangles, colours)


class _Beside:
    """The parts of a world that lie in its folder, as trimesh asks for them by their names."""

    def __init__(self, path: Path) -> None:
        self._path, self._folder = path, path.parent.resolve()
        self.refusal: MapError | None = None
        """Of the last name that is none of a file there: trimesh goes on without it."""

    def get(self, name: str) -> bytes:
        """The bytes of a file; FileNotFoundError where there is none."""
        try:
            file = (self._folder / name.strip().replace("\\", "/")).resolve()
            stands, is_file = file.exists(), file.is_file()
        except (OSError, ValueError, RuntimeError):  # too long, a zero byte, links in a ring
            raise self._refused(f"names {name!r}, which is no name of a file") from None
        if not file.is_relative_to(self._folder):
            raise self._refused(f"names {name}, outside its folder: copy that file beside it")
        if stands and not is_file:
            raise self._refused(f"names {name}, which is no file: a folder, a device or a pipe")
        return file.read_bytes()

    __getitem__ = get

    def _refused(self, why: str) -> MapError:
        self.refusal = MapError(f"{self._path}: {why}")
        return self.refusal


def _arrays(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8]]:
    """Vertices (V, 3), triangles (T, 3) and colours (V, 3) of all that the file holds."""
    import trimesh

    trimesh.util.log.setLevel("CRITICAL")  # what is wrong with a file is said here
    beside, kind = _Beside(path), path.suffix.lower()[1:]
    try:
        with path.open("rb") as stream, np.errstate(all="ignore"):
            scene = trimesh.load_scene(stream, kind, resolver=beside, process=False)
            solids = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh)]
            counts = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
            vertices = [_vertices(solid) for solid in solids]
            corners = [_corners(solid) + n for solid, n in zip(solids, counts, strict=False)]
            colours = [_colours(solid) for solid in solids]
            if not solids:
                raise ValueError("no mesh")
    except Exception as error:  # a damaged file may end in any of Python's errors
        raise beside.refusal or MapError(
            f"{path}: holds no triangles that could be surfaces ({error})"
        ) from None
    if beside.refusal is not None:
        raise beside.refusal
    triangles = np.concatenate(corners).astype(np.int32)
    return np.concatenate(vertices), triangles, np.concatenate(colours)


def _vertices(solid: Any) -> NDArray[np.float64]:
    """Points (V, 3) in metres; ValueError for those of fewer coordinates."""
    vertices = np.asarray(solid.vertices, np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError("points without three coordinates")
    return vertices


def _corners(solid: Any) -> NDArray[np.int64]:
    """Triangles (T, 3) by the numbers of their corners; ValueError for one that does not exist."""
    faces = np.asarray(solid.faces, np.int64)
    if not 0 <= faces.min(initial=0) <= faces.max(initial=0) < len(solid.vertices):
        raise ValueError("corners that do not exist")
    return faces


def _colours(solid: Any) -> NDArray[np.uint8]:
    """(V, 3) of the vertices' own colours or of the texture under them, else grey."""
    if not solid.visual.defined:
        return np.full((len(solid.vertices), 3), _GREY, np.uint8)
    found = solid.visual.to_color() if solid.visual.kind == "texture" else solid.visual
    return np.asarray(found.vertex_colors[:, :3], np.uint8)
