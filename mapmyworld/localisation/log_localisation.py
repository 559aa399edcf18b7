"""A log in a finished map: plan, frames, and the sensor that finds the place."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapmyworld.config import Config
from mapmyworld.errors import LogError
from mapmyworld.localisation.known_place import known_place_from_grid, known_place_from_store
from mapmyworld.localisation.laser_localisation import LaserLocaliser
from mapmyworld.parallel import made_ahead
from mapmyworld.sensing import Plan, make_plan, read_frames, survey_log
from mapmyworld.types import LogSource, MapStore, OccupancyGrid, Progress
from mapmyworld.types.localisation import Localisation

if TYPE_CHECKING:
    from mapmyworld.localisation.camera_localisation import CameraLocaliser
    from mapmyworld.localisation.known_images import KnownImages


def plan_log(log: LogSource, config: Config, progress: Progress) -> Plan:
    """Which of the log's topics are used, and how."""
    info = log.info()
    progress.stage("survey", max(info.duration_s, 1e-9), "s")
    plan = make_plan(
        survey_log(log, lambda t: progress.update((t - info.start_ns) * 1e-9)), config.sensing
    )
    for warning in plan.warnings:
        progress.note(warning)
    return plan


def localise_log(
    where: MapStore | OccupancyGrid, log: LogSource, plan: Plan, config: Config, progress: Progress
) -> Localisation:
    """The pose in the map for every frame of a log; raises `LogError` where they share no sensor.

    By laser where the log has one and the map a grid, with the images' help where both have
    them; else by images.
    """
    info = log.info()
    progress.stage("read the map")
    localiser = _localiser(where, plan, config)
    progress.stage("localise", max(info.duration_s, 1e-9), "s")
    frames = read_frames(
        log, plan, config.sensing, None, lambda t: progress.update((t - info.start_ns) * 1e-9)
    )
    estimates = localiser.follow(made_ahead(frames))
    for note in localiser.notes:
        progress.note(note)
    return Localisation(tuple(estimates), tuple(localiser.notes), (*plan.losses, *log.losses()))


def _localiser(
    where: MapStore | OccupancyGrid, plan: Plan, config: Config
) -> LaserLocaliser | CameraLocaliser:
    if isinstance(where, OccupancyGrid):
        if plan.scan is None:
            raise LogError(
                "a grid alone needs a laser, and this log has none: give a map.db with images"
            )
        return LaserLocaliser(known_place_from_grid(where, config), config)
    images = None
    if plan.camera is not None and where.words():
        images = _known_images(where, config)
    if plan.scan is not None and where.grid() is not None:
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
