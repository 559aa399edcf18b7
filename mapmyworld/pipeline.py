"""From a log to a map: the page to read first. Each stage is one line."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.config.stage_settings import FIRST_READ, FIRST_READ_BY_PARTICLES, settings_of
from mapmyworld.decisions import decided
from mapmyworld.errors import ConfigError, MapError
from mapmyworld.map_figures import map_figures
from mapmyworld.parallel import on_one_thread
from mapmyworld.stages.draw_maps import draw_maps
from mapmyworld.stages.first_pass import deskewed
from mapmyworld.stages.plan_log import note_plan, plan_log
from mapmyworld.stages.recognise import LoadScans, recognise, scan_loader
from mapmyworld.stages.record import StageRecord
from mapmyworld.stages.track import odometry_lag, track
from mapmyworld.types import LogSource, MapStore, Progress


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What a build made, in numbers."""

    nodes: int
    frames: int
    distance_m: float
    """Length of the final path."""
    duration_s: float
    """Of what was tracked."""
    constraints: dict[str, dict[str, int]]
    """Kind -> tried, accepted and rejected."""
    reused_stages: tuple[str, ...]
    losses: tuple[str, ...]
    """What the map lacks, one line each; empty for a complete map."""


@on_one_thread
def build_map(
    log: LogSource,
    store: MapStore,
    config: Config,
    progress: Progress,
    *,
    method: str = "graph",
    words: Mapping[int, NDArray[np.uint8]] | None = None,
) -> BuildResult:
    """Builds the map of a log into the store; stages done with the same inputs are not redone.

    `words`: the vocabulary that `places.vocabulary` names, number -> descriptor (D,). Raises
    `ConfigError` where `places.vocabulary` names a file and no words are given.
    """
    if config.places.vocabulary and words is None:
        raise ConfigError("places.vocabulary names a file, but its words were not given")
    record = StageRecord(store, _same_log(store, log))
    decided("settings", str(config))
    plan = functools.cache(lambda: deskewed(log, plan_log(log, config, progress), config, progress))
    given = (store, config, progress)
    first_read = FIRST_READ_BY_PARTICLES if method == "fastslam" else FIRST_READ

    def run(stage: str, work: Callable[[], None], *inputs: Any) -> None:
        record.run(stage, (settings_of(stage, config, first_read), *inputs), work)

    run("plan", lambda: note_plan(store, plan()))
    if method == "fastslam":
        from mapmyworld.stages.track_particles import finish_particles, track_particles

        run("track", lambda: track_particles(log, plan(), *given), method)
        log.let_go()
        run("fastslam", lambda: finish_particles(store, config))
    else:
        scans = scan_loader(store, config)
        run("track", lambda: track(log, plan(), *given))
        if lag := odometry_lag(log, plan, store, config):  # reported: it is tracked once more
            record.again("track", lambda: track(log, plan(), *given, lag_s=lag))
        log.let_go()
        run("recognise", lambda: recognise(*given, scans, words), _digest(words))
        run("optimise", lambda: _solve(*given, scans), store.get("edits") or None)
    run("map", lambda: draw_maps(*given))
    return _result(store, record)


def _solve(store: MapStore, config: Config, progress: Progress, scans: LoadScans) -> None:
    from mapmyworld.stages.solve_and_judge import solve_and_judge

    solve_and_judge(store, config, progress, scans)


def _digest(words: Mapping[int, NDArray[np.uint8]] | None) -> str:
    """The content of a given vocabulary; empty without one."""
    if words is None:
        return ""
    numbers = sorted(words)
    content = np.stack([words[number] for number in numbers]).tobytes()
    return hashlib.sha256(repr(numbers).encode() + content).hexdigest()


def _same_log(store: MapStore, log: LogSource) -> str:
    """The log's hash; a map of another log is not continued once that was followed to its end."""
    known, found = store.get("log"), log.content_hash()
    if known is not None and known["hash"] != found and store.stage_done("track", None):
        made_of = ", ".join(known["paths"])
        raise MapError(
            f"the map was made of another log ({made_of}): give --overwrite to replace it, or "
            "another name with -o"
        )
    if known is None and store.nodes():
        raise MapError(
            "the map was made of a graph or of other maps, not of a log: give --overwrite to "
            "replace it, or another name with -o"
        )
    if known is None or known["hash"] != found:  # which may have been read before it was whole
        names = [path.replace("\\", "/").rsplit("/", 1)[-1] for path in log.info().paths]
        store.put("log", {"hash": found, "paths": names})
    return found


def _result(store: MapStore, record: StageRecord) -> BuildResult:
    figures = map_figures(store)
    notes = [store.get(key) or {} for key in ("plan", "track", "solve")]
    return BuildResult(
        nodes=figures.nodes,
        frames=figures.frames,
        distance_m=figures.path_m,
        duration_s=figures.duration_s,
        constraints=figures.constraints,
        reused_stages=tuple(record.reused),
        losses=tuple(dict.fromkeys(line for note in notes for line in note.get("losses", ()))),
    )
