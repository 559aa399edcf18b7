"""A log in a finished map: plan, frames, and the sensor that finds the place."""

from __future__ import annotations

from mapmyworld.config import Config
from mapmyworld.errors import LogError
from mapmyworld.localisation.known_place import known_place_from_grid, known_place_from_store
from mapmyworld.localisation.laser import LaserLocaliser
from mapmyworld.parallel import made_ahead
from mapmyworld.sensing import Plan, make_plan, read_frames, survey_log
from mapmyworld.types import LogSource, MapStore, OccupancyGrid, Progress
from mapmyworld.types.localisation import Localisation


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
    """The pose in the map for every frame of a log."""
    info = log.info()
    if plan.scan is None:
        raise LogError("no laser")
    progress.stage("map")
    if isinstance(where, OccupancyGrid):
        place = known_place_from_grid(where, config)
    else:
        place = known_place_from_store(where, config)
    progress.stage("localise", max(info.duration_s, 1e-9), "s")
    frames = read_frames(
        log, plan, config.sensing, None, lambda t: progress.update((t - info.start_ns) * 1e-9)
    )
    localiser = LaserLocaliser(place, config)
    estimates = localiser.follow(made_ahead(frames))
    for note in localiser.notes:
        progress.note(note)
    return Localisation(tuple(estimates), tuple(localiser.notes), (*plan.losses, *log.losses()))
