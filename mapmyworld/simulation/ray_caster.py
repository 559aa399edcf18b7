"""Rays against triangles, by Embree: what each ray meets first, and where on the triangle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MissingDependencyError


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The first triangle that each ray meets."""

    distance: NDArray[np.float32]
    """(P,) in lengths of the ray; infinite where nothing is met."""
    triangle: NDArray[np.int32]
    """(P,); 0 where nothing is met."""
    uv: NDArray[np.float32]
    """(P, 2) weights of the triangle's second and third corner there."""


class RayCaster:
    """Triangles (T, 3, 3) made ready for rays, without GPU, display or system library.

    Raises `MissingDependencyError` where embreex does not load.
    """

    def __init__(self, corners: NDArray[np.float32]) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingDependencyError(
                f"a camera needs embreex, which does not load ({error}): `pip install embreex` "
                "(it exists for x86-64), or --no-camera leaves the camera out"
            ) from None
        # Robust: no ray slips through between two triangles that share an edge.
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))

    def cast(self, origins: NDArray[np.floating], ways: NDArray[np.floating]) -> Hits:
        """What rays along `ways` (P, 3) from `origins` (3,) or (P, 3) meet."""
        starts = np.ascontiguousarray(np.broadcast_to(origins, ways.shape), np.float32)
        met = self._scene.run(starts, np.ascontiguousarray(ways, np.float32), output=True)
        struck = met["primID"] >= 0
        return Hits(
            np.where(struck, met["tfar"], np.float32(np.inf)),
            np.where(struck, met["primID"], 0),
            np.stack([met["u"], met["v"]], axis=1),
        )
