"""A log in a finished map: frames, and the sensor that finds the place."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapmyworld.config import Config
from mapmyworld.errors import LogError, MapError
from mapmyworld.localisation.known_place import known_place_from_grid, known_place_from_store
from mapmyworld.localisation.laser_localisation import LaserLocaliser
from mapmyworld.parallel import made_ahead
from mapmyworld.sensing import Plan, read_frames
from mapmyworld.stages.first_pass import deskewed
from mapmyworld.stages.plan_log import stage_of_log
from mapmyworld.types import LogSource, MapStore, OccupancyGrid, Progress
from mapmyworld.types.localisation import Localisation

if TYPE_CHECKING:
    from mapmyworld.localisation.camera_localisation import CameraLocaliser
    from mapmyworld.localisation.known_images import KnownImages


def localise_log(
    where: MapStore | OccupancyGrid, log: LogSource, plan: Plan, config: Config, progress: Progress
) -> Localisation:
    """The pose in the map for every frame of a log.

    Raises `LogError` where they share no sensor, and `MapError` for a map without a grid. By laser
    where the log has one, with the images' help where both have them; else by images.
    """
    progress.stage("read the map")
    localiser = _localiser(where, plan, config)
    plan = deskewed(log, plan, config, progress)
    frames = read_frames(log, plan, config.sensing, None, stage_of_log("localise", log, progress))
    estimates = localiser.follow(made_ahead(frames))
    for note in localiser.notes:
        progress.note(note)
    losses = dict.fromkeys((*plan.losses, *log.info().problems))
    return Localisation(tuple(estimates), tuple(localiser.notes), tuple(losses))


def _localiser(
    where: MapStore | OccupancyGrid, plan: Plan, config: Config
) -> LaserLocaliser | CameraLocaliser:
    if isinstance(where, OccupancyGrid):
        if plan.scan is None:
            raise LogError(
                "a grid alone needs a laser, and this log has none: give a map.db with images"
            )
        return LaserLocaliser(known_place_from_grid(where, config), config)
    if where.grid() is None:
        raise MapError("the map has no grid: build it to its end first")
    images = None
    if plan.camera is not None and where.words():
        images = _known_images(where, config)
    if plan.scan is not None:
        return LaserLocaliser(known_place_from_store(where, config), config, images)
    if images is not None:
        from mapmyworld.localisation.camera_localisation import CameraLocaliser

        return CameraLocaliser(images, plan, config)
    raise LogError(
        "the map and the log share no sensor: a laser needs a map with a grid, a camera one that "
        "keeps its images"
    )


def _known_images(store: MapStore, config: Config) -> KnownImages | None:
    from mapmyworld.localisation.known_images import KnownImages

    found = KnownImages(store, config)
    return found if len(found) else None
