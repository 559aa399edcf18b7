"""`build --append`: each log becomes a session of its own in a map that may exist already."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.config_sources import settings_that_differ
from cli.merging import extend_file, merge_files
from cli.storing import storage_arguments
from mapmyworld.errors import MapError

if TYPE_CHECKING:
    from cli.progress import StderrProgress
    from mapmyworld.config import Config


def append_logs(
    logs: Sequence[Path],
    map_path: Path,
    config: Config,
    progress: StderrProgress,
    *,
    export: bool,
) -> dict[str, Any]:
    """Builds a map of each log and lays it into MAP, which is replaced when all is done.

    Raises `MapError` where MAP's folder does not exist.
    """
    if not map_path.absolute().parent.is_dir():
        raise MapError(f"{map_path}: its folder does not exist")
    with tempfile.TemporaryDirectory(dir=map_path.absolute().parent, prefix=".append-") as folder:
        built = [
            _build(log, Path(folder) / f"{number}" / f"{log.stem}.db", config, progress)
            for number, log in enumerate(logs)
        ]
        if map_path.exists():
            summary = extend_file(map_path, built, config, progress, export=export)
        else:
            summary = merge_files(built, map_path, config, progress, export=export)
        names = {str(path): str(log) for path, log in zip(built, logs, strict=True)}
    for made in summary["maps"]:
        made["of"] = [names.get(name, name) for name in made["of"]]
    return summary


def _build(log: Path, path: Path, config: Config, progress: StderrProgress) -> Path:
    from formats.database import open_store
    from formats.logs import open_log
    from mapmyworld.pipeline import build_map

    path.parent.mkdir()
    opening = partial(open_store, path, create=True, **storage_arguments(config))
    with opening() as store:
        store.put("settings", settings_that_differ(config))
        build_map(open_log([log]), store, config, progress)
    progress.finish()  # a log's stages are distinguished from the next one's
    return path
