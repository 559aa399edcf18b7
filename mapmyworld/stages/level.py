"""The end of tracking where a camera was carried: z becomes up, and 0 the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.parallel import algebra_on_one_thread, in_threads
from mapmyworld.sensing import Plan
from mapmyworld.types import CameraModel, MapStore, Node

if TYPE_CHECKING:
    from mapmyworld.mapping.level import Level, Surfaces

_VIEWS = 60  # nodes whose depth is looked at, at most


def level_map(
    store: MapStore, plan: Plan, config: Config, force: NDArray[np.float64] | None
) -> tuple[str, ...]:
    """Turns and lifts all tracked poses if the camera was carried, and says so in a line.

    `force` (3,): what an accelerometer felt, see `FeltForce`. A robot's base is level already; so
    is whatever moves in a plane.
    """
    if plan.camera is None or plan.scan is not None or plan.planar:
        return ()
    nodes, camera = store.nodes(), plan.camera.model
    if not nodes or not camera.is_carried:
        return ()
    tracked = np.stack([node.tracked_from_base for node in nodes])
    with algebra_on_one_thread():
        level = _level(store, nodes, tracked, camera, config, force)
    if level is None:
        return ("nothing level was seen: z is up as the first picture was held",)
    store.set_tracked_poses(level.level_from_map @ tracked)
    return (f"the camera was carried: {level.reason}",)


def _level(
    store: MapStore,
    nodes: Sequence[Node],
    tracked: NDArray[np.float64],
    camera: CameraModel,
    config: Config,
    force: NDArray[np.float64] | None,
) -> Level | None:
    from mapmyworld.mapping.level import find_level

    mean_up = -(tracked[:, :3, :3] @ camera.base_from_camera[:3, 1]).mean(axis=0)
    return find_level(_seen(store, nodes, config), mean_up, force)


def _seen(store: MapStore, nodes: Sequence[Node], config: Config) -> Surfaces:
    from mapmyworld.mapping.level import joined, surfaces_of

    chosen = nodes[:: max(1, -(-len(nodes) // _VIEWS))]
    items = (
        (image, node.tracked_from_base)
        for node in chosen
        for image in store.node_data(node.id, features=False).images
        if image.depth is not None
    )
    found = in_threads(lambda item: surfaces_of(*item, config), items, config.threads)
    return joined(found)
