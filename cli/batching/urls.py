"""Logs and maps here or elsewhere: plain paths, or URLs by fsspec."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mapmyworld.errors import LogError, MapError, MissingDependencyError

_URL = re.compile(r"[a-z][a-z0-9+.-]*://")


def is_url(place: str) -> bool:
    """Whether a place is addressed by a URL: s3://..., gs://..., https://..."""
    return _URL.match(place) is not None


def fetched(place: str, folder: Path) -> Path:
    """The file or folder as a local path: itself, or a copy in `folder`. Raises `LogError`."""
    if not is_url(place):
        return Path(place)
    system, path = _system(place)
    target = folder / (path.rstrip("/").rsplit("/", 1)[-1] or "log")
    try:
        system.get(path.rstrip("/"), str(target), recursive=bool(system.isdir(path)))
    except Exception as error:  # every store raises a family of its own
        raise LogError(f"{place}: cannot be fetched: {_line(error)}") from error
    return target


def delivered(files: Iterable[Path], place: str) -> None:
    """Copies files into the folder at a URL. Raises `MapError`."""
    system, path = _system(place)
    try:
        system.makedirs(path, exist_ok=True)
        for file in files:
            system.put(str(file), f"{path.rstrip('/')}/{file.name}")
    except Exception as error:
        raise MapError(f"{place}: cannot be written: {_line(error)}") from error


def read_text(place: str) -> str | None:
    """The text at a path or URL; None where there is none."""
    try:
        if not is_url(place):
            return Path(place).read_text("utf-8")
        system, path = _system(place)
        return str(system.cat_file(path).decode("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def mark_of(place: str) -> str:
    """What changes when the file does: its size and time, or what its store reports about it."""
    if is_url(place):
        system, path = _system(place)
        try:
            return str(system.ukey(path))
        except Exception:
            return "absent"
    local = Path(place)
    files = sorted(local.rglob("*")) if local.is_dir() else [local]
    try:
        return "; ".join(f"{f.name} {f.stat().st_size} {f.stat().st_mtime_ns}" for f in files)
    except OSError:
        return "absent"


def _system(place: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise MissingDependencyError(
            f"{place}: URLs need fsspec: pip install 'mapmyworld[distributed]'"
        ) from None
    try:
        system, path = fsspec.core.url_to_fs(place)
    except (ImportError, ValueError) as error:  # no such protocol, or its package is absent
        raise MissingDependencyError(f"{place}: {_line(error)}") from None
    return system, str(path)


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]
