"""A user's own world: a mesh from PLY, OBJ, GLB and whatever else Open3D reads."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.scene_claims import check_claims
from formats.scene_reading import NOT_THERE
from mapmyworld.errors import MapError
from mapmyworld.open3d_library import missing_open3d
from mapmyworld.types import Mesh

SCENE_SUFFIXES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off")
_FARTHEST = 10_000.0  # m from the origin, where a robot could drive
_Y_UP = (".glb", ".gltf")  # formats whose standard says that y points up


def read_scene_mesh(path: Path) -> Mesh:
    """The mesh with z up and a colour at each vertex, textures sampled; metres are assumed.

    Raises `MapError` where the file is no mesh, `MissingDependencyError` without Open3D.
    """
    if not path.is_file():
        raise MapError(f"{path}: there is no such file")
    check_claims(path)
    arrays = _arrays(path)
    vertices, triangles = arrays["vertices"], arrays["triangles"]
    named = 0 <= triangles.min(initial=0) <= triangles.max(initial=0) < len(vertices)
    if len(triangles) == 0 or not named or not np.isfinite(vertices).all():
        raise MapError(f"{path}: holds no triangles that could be a world")
    if np.abs(vertices).max() > _FARTHEST:
        raise MapError(f"{path}: reaches beyond {_FARTHEST:.0f} m: export the mesh in metres")
    if path.suffix.lower() in _Y_UP:
        vertices = vertices @ np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    return Mesh(vertices.astype(np.float32), triangles, arrays["colours"])


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """What Open3D reads of the file; it ends whole processes over some damaged ones."""
    task = f"import sys; sys.path[:] = {sys.path!r}\n"
    task += "from formats.scene_reading import give_mesh; give_mesh(sys.argv[1])"
    command = [sys.executable, "-c", task, str(path.resolve())]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode == NOT_THERE:
        raise missing_open3d(f"reading {path.name}", done.stdout.decode("utf-8", "replace"))
    try:
        with np.load(io.BytesIO(done.stdout)) as found:
            return dict(found)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        raise MapError(f"{path}: holds no triangles that could be a world") from None
