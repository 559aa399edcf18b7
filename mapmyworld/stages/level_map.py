"""Where a camera was carried, the map is turned and lifted: z becomes up, and 0 the floor."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.parallel import in_threads
from mapmyworld.sensing.plan import moves_in_plane
from mapmyworld.stages.kept import has_images, has_scans
from mapmyworld.types import ConstraintKind, Judged, MapStore, Poses, RgbdImage

if TYPE_CHECKING:
    from mapmyworld.mapping.level_surfaces import Level, Surfaces

_VIEWS = 60  # nodes whose depth is looked at, at most


def levelled_poses(
    store: MapStore, poses: Poses, constraints: Iterable[Judged], config: Config
) -> tuple[Poses, tuple[str, ...]]:
    """Solved poses, turned and lifted if the camera was carried, and a line that says so.

    What moves in a plane is level already, and so is a robot's base. Where somebody pinned a node,
    the map stays there.
    """
    pinned = any(c.accepted and c.kind is ConstraintKind.PRIOR for c in constraints)
    if pinned or moves_in_plane(store) or has_scans(store) or not has_images(store):
        return poses, ()
    images = _carried_images(store, poses)
    found = list(in_threads(functools.partial(_look, config), images, config.threads))
    if not found:
        return poses, ()
    level = _level(found, store.get("gravity_direction"))
    moved = replace(poses, map_from_node=level.level_from_map @ poses.map_from_node)
    height = moved.map_from_node[0, 2, 3]
    return moved, (f"hand-held camera: {level.reason}; its first pose is {height:.2f} m high",)


def _carried_images(store: MapStore, poses: Poses) -> Iterator[tuple[RgbdImage, Array]]:
    """Images with depth of carried cameras, all along the way, with their nodes' poses (4, 4)."""
    nodes = np.flatnonzero(poses.ids > 0)
    for row in nodes[:: max(1, -(-len(nodes) // _VIEWS))]:
        for image in store.node_data(int(poses.ids[row]), features=False).images:
            if image.depth is not None and image.camera.is_carried:
                yield image, poses.map_from_node[row]


def _look(config: Config, item: tuple[RgbdImage, Array]) -> tuple[Surfaces, Array]:
    """An image's surfaces, and how (3, 3) its camera is turned."""
    from mapmyworld.mapping.level_surfaces import surfaces_of

    image, map_from_base = item
    map_from_camera = map_from_base @ image.camera.base_from_camera
    return surfaces_of(image, map_from_base, config), map_from_camera[:3, :3]


def _level(found: Sequence[tuple[Surfaces, Array]], force: Sequence[float] | None) -> Level:
    from mapmyworld.mapping.level_surfaces import find_level, joined, up_as_held

    held = up_as_held(np.stack([turned for _, turned in found]))
    surfaces = joined(some for some, _ in found)
    return find_level(surfaces, held, None if force is None else np.array(force))
