"""Maps as files: built with the settings their database wants, put in place when whole."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmyworld.errors import MapMyWorldError

if TYPE_CHECKING:
    from cli.progress import StderrProgress
    from mapmyworld.config import Config
    from mapmyworld.pipeline import BuildResult
    from mapmyworld.types import LogSource, MapStore


@contextmanager
def no_empty_map(path: Path) -> Iterator[None]:
    """Where what is done inside fails, a map without nodes goes: nothing could be made of it."""
    from formats.database import open_store
    from formats.database.connection import says_ours

    try:
        yield
    except MapMyWorldError:
        with suppress(MapMyWorldError), open_store(path, read_only=True) as store:
            if says_ours(path) and not store.nodes():
                path.unlink()
        raise


def build_into(
    store: MapStore, log: LogSource, config: Config, progress: StderrProgress, method: str = "graph"
) -> BuildResult:
    """Builds the log's map, and notes the settings that are not as usual."""
    from cli.config import settings_that_differ
    from formats.logs.steady import SteadyLog
    from formats.vocabulary_files import read_vocabulary
    from mapmyworld.pipeline import build_map

    store.put("settings", settings_that_differ(config))
    given = config.places.vocabulary  # else the words are learned from the log
    words: dict[int, Any] | None = read_vocabulary(Path(given)) if given else None
    return build_map(SteadyLog(log), store, config, progress, method=method, words=words)


def products_beside(
    store: MapStore,
    map_path: Path,
    config: Config,
    progress: StderrProgress,
    duration_s: float | None = None,
    *,
    export: bool = True,
    continued: bool = False,
) -> tuple[list[str], dict[str, float]]:
    """Writes grid, trajectory, cloud and page of a map just made, where they are wanted; gives
    their names, and what all took but the page, which shows it.

    `duration_s` is that of the log; `continued`: some stages were done before.
    """
    written: list[str] = []
    if export:
        from mapmyworld.exporting import export_beside

        progress.stage("export")
        written += export_beside(store, map_path, config)
    progress.end()
    cost = progress.spent()
    if duration_s is not None:
        cost = {"duration_s": duration_s, **cost}
        cost["real_time_factor"] = duration_s / max(cost["wall_s"], 1e-9)
    if export:
        from cli.report import note_timing, write_report

        progress.stage("report")
        note_timing(map_path, cost, list(progress.costs.values()), continued=continued)
        page = map_path.with_suffix(".html")
        write_report(store, page)
        progress.finish()
        written.append(str(page))
    return written, cost


def storage_arguments(config: Config) -> dict[str, Any]:
    """Arguments of `formats.database.open_store` for a map built with this configuration."""
    return {**asdict(config.storage), "parameters": rtabmap_parameters(config)}


def rtabmap_parameters(config: Config) -> dict[str, str]:
    """Settings that have a counterpart in RTAB-Map, under its names."""
    visual = config.visual
    return {
        "Grid/3D": "false",
        "Grid/CellSize": str(config.mapping.resolution),
        "Grid/MaxGroundHeight": str(visual.obstacle_lowest),
        "Grid/MaxObstacleHeight": str(visual.obstacle_highest),
        "Kp/MaxFeatures": str(visual.place_features),
        "Mem/ImageCompressionFormat": ".png" if config.storage.image_codec == "png" else ".jpg",
        "Optimizer/Strategy": "2",  # GTSAM
        "RGBD/AngularUpdate": str(config.sensing.node_angle),
        "RGBD/LinearUpdate": str(config.sensing.node_distance),
        "Vis/MaxFeatures": str(visual.feature_count),
        "Vis/MinInliers": str(visual.closure_inliers),
    }


class ResultMaps:
    """The maps in the making beside OUTPUT; gone unless they are put in its place.

    `spare`: the further maps take numbers that are free, so that no earlier map is lost.
    """

    def __init__(self, output: Path, config: Config, *, spare: bool = False) -> None:
        self._output, self._stored = output, storage_arguments(config)
        self._spare = spare
        self.names: list[Path] = []
        """What the maps will be called."""

    def __enter__(self) -> ResultMaps:
        return self

    def __exit__(self, *_: object) -> None:
        for name in self.names:
            _part_of(name).unlink(missing_ok=True)

    def discard(self) -> None:
        """Removes what was written, so that other maps take its place."""
        self.__exit__()
        self.names = []

    @contextmanager
    def open(self) -> Iterator[MapStore]:
        """The next map, empty."""
        from formats.database import open_store

        path = self._next()
        with open_store(path, create=True, overwrite=True, **self._stored) as store:
            yield store

    @contextmanager
    def copy_of_output(self) -> Iterator[MapStore]:
        """OUTPUT as it was, to be extended."""
        from formats.database import open_store

        open_store(self._output, read_only=True).close()  # refuses what is no map
        path = self._next()
        shutil.copyfile(self._output, path)
        with open_store(path, **self._stored) as store:
            yield store

    def _next(self) -> Path:
        number = len(self.names)
        path = numbered(self._output, number)
        while self._spare and number and (path in self.names or path.exists()):
            number += 1
            path = numbered(self._output, number)
        self.names.append(path)
        return _part_of(path)

    def put_in_place(self) -> None:
        """Gives the finished files their names."""
        for name in self.names:
            os.replace(_part_of(name), name)


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def numbered(output: Path, number: int) -> Path:
    """OUTPUT for the first map, OUTPUT_2 for the second, ..."""
    return output if number == 0 else output.with_stem(f"{output.stem}_{number + 1}")
