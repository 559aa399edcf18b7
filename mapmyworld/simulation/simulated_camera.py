"""The RGB-D camera: views rendered by ray casting on the processor, without GPU or display."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MissingDependencyError
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.kernels.texture_lookup import shade_pixels
from mapmyworld.simulation import robot
from mapmyworld.simulation.clocks import Schedule, random_of
from mapmyworld.simulation.driver import Drive
from mapmyworld.simulation.image_messages import (
    colour_message,
    depth_message,
    disturb_colour,
    disturb_depth,
    exposure_at,
)
from mapmyworld.simulation.message_streams import Messages, Stream
from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.textures import EDGE, TextureSet, texture_set
from mapmyworld.simulation.world import Scene
from mapmyworld.types import CameraModel

COLOUR_TOPIC = "/camera_ir/rgb/image_raw"
DEPTH_TOPIC = "/camera_ir/depth/image_raw"
INFO_TOPIC = "/camera_ir/rgb/camera_info"

_SKY = np.array([188, 208, 230], np.uint8)
_LIGHT = np.array([0.35, 0.52, 0.78])  # where the light comes from, not quite from above
_AMBIENT = 0.66  # share of the light that comes from everywhere


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A clean image: what an ideal camera sees."""

    colour: NDArray[np.uint8]
    """(H, W, 3) RGB."""
    depth: NDArray[np.float32]
    """(H, W) metres along the optical axis; infinite where nothing is met."""
    slant: NDArray[np.float32]
    """(H, W) cosine between the ray and the normal of the surface."""


class Renderer:
    """A scene made ready for views; raises `MissingDependencyError` where embreex is absent."""

    def __init__(self, scene: Scene, settings: SimulationSettings) -> None:
        solid = np.flatnonzero(~scene.glass)
        corners = scene.faces.corners[solid].astype(np.float32)
        self._width, self._height = settings.camera.width, settings.camera.height
        self._rays = _optical_rays(settings)
        self._pixel_angle = 1.0 / float(robot.intrinsics(settings)[0, 0])
        self._normals = _normals(corners)
        self._lights = _lights(self._normals)
        self._paint = _Paint(scene, solid, self._lights)
        self._scene = _embree_scene(corners)

    def render(self, world_from_optical: Array) -> View:
        """What the camera sees from `world_from_optical` (4, 4)."""
        ways = self._rays @ world_from_optical[:3, :3].T.astype(np.float32)
        place = world_from_optical[:3, 3].astype(np.float32)
        return self.cast(place, ways, (self._height, self._width))

    def cast(
        self, origins: NDArray[np.floating], ways: NDArray[np.floating], shape: tuple[int, int]
    ) -> View:
        """What rays (P, 3) from origins (3,) or (P, 3) meet; `shape` is that of the view.

        Rays have length one along the optical axis, so that the distance to the hit is the depth.
        """
        starts = np.ascontiguousarray(np.broadcast_to(origins, ways.shape), np.float32)
        met = self._scene.run(starts, np.ascontiguousarray(ways, np.float32), output=True)
        struck = met["primID"] >= 0
        distance = np.where(struck, met["tfar"], np.float32(np.inf))
        triangle, uv = np.where(struck, met["primID"], 0), np.stack([met["u"], met["v"]], axis=1)
        length = np.linalg.norm(ways, axis=1)
        slant = np.abs(np.einsum("ij,ij->i", self._normals[triangle], ways)) / length
        colour = np.empty((len(ways), 3), np.uint8)
        self._paint.fill(triangle, uv, distance, slant, self._pixel_angle, colour)
        return View(colour.reshape(*shape, 3), distance.reshape(shape), slant.reshape(shape))


def _embree_scene(corners: NDArray[np.float32]) -> Any:
    """Triangles (T, 3, 3) made ready for rays, without GPU, display or system library."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingDependencyError(
            f"a camera needs embreex, which does not load ({error}): `pip install embreex` "
            "(it exists for x86-64), or --no-camera leaves the camera out"
        ) from None
    # Robust: no ray slips through between two triangles that share an edge.
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(corners, np.float32))
    return scene


class _Paint:
    """Colours of the triangles: by texture, or the scene's own at their corners."""

    def __init__(self, scene: Scene, solid: NDArray[np.int64], lights: NDArray[np.float32]) -> None:
        self._lights = lights
        self._corners = None
        if scene.colours is not None:
            self._corners = scene.colours[solid].astype(np.float32)
            return
        names = tuple(sorted({scene.faces.texture[t] for t in solid}))
        number = {name: index for index, name in enumerate(names)}
        self._set: TextureSet = texture_set(names)
        self._texture = np.array([number[scene.faces.texture[t]] for t in solid], np.int32)
        sizes = np.array([[t.width, t.height] for t in self._set.textures])[self._texture]
        stretched = scene.faces.stretched[solid]
        uv = scene.faces.uv[solid] / np.where(stretched[:, None], 1.0, sizes)[:, None, :]
        self._uv = uv.astype(np.float32)
        self._texel_metres = (sizes.min(axis=1) / EDGE).astype(np.float32)

    def fill(
        self,
        triangle: NDArray[np.int32],
        uv: NDArray[np.float32],
        distance: NDArray[np.float32],
        slant: NDArray[np.float32],
        pixel_angle: float,
        colour: NDArray[np.uint8],
    ) -> None:
        """Writes the pixels' colours (P, 3).

        Of triangles met (P,), the weights (P, 2) of their second and third corners there, and
        distances and cosines between ray and normal (P,).
        """
        if self._corners is not None:
            weights = np.concatenate([1.0 - uv.sum(axis=1, keepdims=True), uv], axis=1)
            mixed = np.einsum("pk,pkc->pc", weights, self._corners[triangle])
            lit = np.clip(mixed * self._lights[triangle, None], 0, 255)
            colour[:] = np.where(np.isfinite(distance)[:, None], lit, _SKY)
            return
        shade_pixels(
            triangle,
            uv,
            distance,
            slant.astype(np.float32),
            self._uv,
            self._texture,
            self._lights,
            self._texel_metres,
            self._set.offsets,
            EDGE,
            self._set.texels,
            pixel_angle,
            _SKY,
            colour,
        )


def camera_stream(
    scene: Scene, drive: Drive, schedule: Schedule, settings: SimulationSettings, seed: int
) -> Stream:
    """Colour, depth and intrinsics at every exposure."""
    renderer = Renderer(scene, settings)
    s = settings.camera
    gains = exposure_at(schedule.times, s, random_of(seed, "exposure"))
    base_from_optical = robot.base_from_optical(settings)
    k = robot.intrinsics(settings)
    model = CameraModel(s.width, s.height, k, "plumb_bob", np.zeros(5), np.eye(4))
    suffixes = ("/compressed", "/compressedDepth") if s.compressed else ("", "")
    topics = (INFO_TOPIC, COLOUR_TOPIC + suffixes[0], DEPTH_TOPIC + suffixes[1])

    def messages(index: int) -> Messages:
        pose = planar_to_matrix(drive.at(schedule.times[index : index + 1])[0])
        view = renderer.render(pose @ base_from_optical)
        random = random_of(seed, "camera", index)
        depth = disturb_depth(view.depth, view.slant, s, random)
        colour = disturb_colour(view.colour, float(gains[index]), s, random)
        stamp_ns = int(schedule.stamps_ns[index])
        made = (
            model.info(stamp_ns, robot.OPTICAL),
            colour_message(colour, stamp_ns, s),
            depth_message(depth, stamp_ns, s),
        )
        return list(zip(topics, made, strict=True))

    return Stream(topics, schedule, messages)


def _optical_rays(settings: SimulationSettings) -> NDArray[np.float32]:
    """(H * W, 3) directions of the pixels, length one along the optical axis."""
    k = robot.intrinsics(settings)
    v, u = np.mgrid[0 : settings.camera.height, 0 : settings.camera.width]
    x, y = (u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3).astype(np.float32)


def _normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))


def _lights(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    facing = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    return np.asarray(_AMBIENT + (1.0 - _AMBIENT) * facing, np.float32)
