"""The jobs of a batch: of a folder of logs, or of a manifest, TOML that names logs, how to build
them, and what their maps owe.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.batching.urls import is_url
from cli.gates import read_requirements
from formats.nested_text import read_toml
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings, flatten
from mapmyworld.errors import ConfigError

_FIELDS = {"name", "log", "method", "set", "require", "reference", "relations", "grid"}
_NAME = re.compile(r"[\w.@+-]+")  # becomes a folder's name: no slash, no leading dot

_NO_NAME = re.compile(r"[^\w.@+-]")


@dataclass(frozen=True, slots=True)
class Job:
    """One log of the batch."""

    name: str
    logs: tuple[str, ...]
    """Absolute paths, or URLs."""
    method: str = "graph"
    settings: tuple[str, ...] = ()
    """As `--set` takes them, sorted by name."""
    requirements: tuple[str, ...] = ()
    """As `check --require` takes them."""
    truths: tuple[tuple[str, str], ...] = ()
    """Options of `check` that name a file: (reference, relations or grid; path or URL)."""


def read_manifest(path: Path) -> tuple[Job, ...]:
    """The jobs of a manifest in its order; raises `ConfigError` with all that is wrong at once."""
    table = read_toml(path)
    problems = [f"unknown: {name}" for name in sorted(set(table) - {"log", "defaults"})]
    defaults, entries = table.get("defaults", {}), table.get("log", [])
    if not isinstance(defaults, dict) or not isinstance(entries, list) or not entries:
        raise ConfigError(f"{path}: name at least one log: [[log]] and under it log = FILE")
    jobs = [_job(entry, defaults, path.parent, problems) for entry in entries]
    names = [job.name for job in jobs if job is not None]
    problems += [
        f"two logs are called {name!r}: give one of them another name = ..."
        for name in sorted({name for name in names if names.count(name) > 1})
    ]
    if problems:
        raise ConfigError(f"{path}: the batch cannot be run:", problems=problems)
    return tuple(job for job in jobs if job is not None)


def jobs_of_folder(folder: Path) -> tuple[Job, ...]:
    """A job for each log in a folder; raises `ConfigError` where there is none."""
    from formats.logs.opening_logs import logs_in

    logs = logs_in(folder)
    if not logs:
        raise ConfigError(f"{folder}: no log in this folder: name another, or a manifest")
    stems = [_stem(paths[0].name) for paths in logs]
    names = [
        stem if stems.count(stem) == 1 else paths[0].name
        for stem, paths in zip(stems, logs, strict=True)
    ]
    return tuple(
        Job(_NO_NAME.sub("_", name).lstrip(".") or "log", tuple(str(p.absolute()) for p in paths))
        for name, paths in zip(names, logs, strict=True)
    )


def _job(entry: Any, defaults: Mapping[str, Any], folder: Path, problems: list[str]) -> Job | None:
    if not isinstance(entry, dict) or "log" not in entry:
        problems.append(f"{entry!r}: names no log")
        return None
    both = {**defaults, **entry}
    logs = [both["log"]] if isinstance(both["log"], str) else both["log"]
    if not (isinstance(logs, list) and logs and all(isinstance(log, str) for log in logs)):
        problems.append(f"log = {both['log']!r}: give a path, a URL or a list of them")
        return None
    name = str(both.get("name", _stem(logs[0])))
    problems += [f"{name}: unknown: {key}" for key in sorted(set(both) - _FIELDS)]
    if _NAME.fullmatch(name) is None or name.startswith("."):
        problems.append(f"{name!r} cannot name a folder: letters, digits and . _ - + @ only")
    if both.get("method", "graph") not in ("graph", "fastslam"):
        problems.append(f"{name}: method = {both['method']!r}: graph or fastslam")
    settings = _checked(
        name, lambda: _settings(defaults.get("set", {}), entry.get("set", {})), problems
    )
    wanted = [*defaults.get("require", []), *entry.get("require", [])]
    if wanted:
        _checked(name, lambda: read_requirements(tuple(map(str, wanted))), problems)
    truths = [
        (option, _placed(str(both[option]), folder))
        for option in ("reference", "relations", "grid")
        if option in both
    ]
    return Job(
        name,
        tuple(_placed(log, folder) for log in logs),
        str(both.get("method", "graph")),
        tuple(settings or ()),
        tuple(map(str, wanted)),
        tuple(truths),
    )


def _stem(log: str) -> str:
    return log.rstrip("/").rsplit("/", 1)[-1].split(".")[0] or "log"


def _settings(*tables: Mapping[str, Any]) -> list[str]:
    """`KEY=VALUE` of all tables, later ones winning; raises `ConfigError`."""
    values: dict[str, Any] = {}
    for table in tables:
        values |= flatten(table)
    apply_settings(Config(), values)
    return [f"{name}={_text(value)}" for name, value in sorted(values.items())]


def _text(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def _checked(name: str, read: Any, problems: list[str]) -> Any:
    try:
        return read()
    except ConfigError as error:
        problems += [f"{name}: {problem}" for problem in error.problems or [str(error)]]
    except (TypeError, AttributeError):
        problems.append(f"{name}: set = {{ ... }} is a table, require = [ ... ] a list")
    return None


def _placed(place: str, folder: Path) -> str:
    """A path seen from the manifest's folder; a URL as it is."""
    return place if is_url(place) else str((folder / place).absolute())
