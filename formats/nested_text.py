"""TOML and JSON from files that may be damaged, nested deeper than their parsers go."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mapmyworld.errors import ConfigError

_DEEP = "brackets within brackets, too many to follow"


def read_toml(path: Path) -> dict[str, Any]:
    """The table of a TOML file; `ConfigError` where it has none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except RecursionError:
        raise ConfigError(f"{path}: is not valid TOML: {_DEEP}") from None
    except ValueError as error:  # no TOML, no UTF-8, or an integer of thousands of digits
        raise ConfigError(f"{path}: is not valid TOML: {error}") from None


def json_from_text(
    text: str | bytes, *, object_hook: Callable[[dict[str, Any]], Any] | None = None
) -> Any:
    """The value; `ValueError` where the text has none, `TypeError` where it is no text."""
    try:
        return json.loads(text, object_hook=object_hook)
    except RecursionError:
        raise ValueError(_DEEP) from None
