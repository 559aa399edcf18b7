"""Settings by dotted name: listed with their meaning, changed, and refused when unknown."""

from __future__ import annotations

import difflib
import functools
import inspect
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from mapmyworld.config import Config
from mapmyworld.config.ranges import Range
from mapmyworld.errors import ConfigError

_FINITE = Range(is_open=True)
# Of numbers without an end of their own: beyond these no unit makes sense, and products overflow.
_SMALLEST, _LARGEST = 1e-15, 1e10


@dataclass(frozen=True, slots=True)
class Setting:
    """One leaf of the configuration."""

    name: str
    """Dotted, e.g. "mapping.resolution"."""
    value: Any
    meaning: str
    """The comment that stands behind it: unit and meaning."""
    allowed: Range = _FINITE
    """Of a number."""
    choices: tuple[str, ...] = ()
    """Of a word; empty where any will do."""


def list_settings(config: Config | None = None) -> tuple[Setting, ...]:
    """Every setting of a configuration, in the order of the source."""
    return tuple(_walk(config or Config(), ""))


def _walk(section: Any, prefix: str) -> list[Setting]:
    found: list[Setting] = []
    kind: Any = type(section)
    comments, hints = _described(kind)
    for item in fields(section):
        value = getattr(section, item.name)
        if is_dataclass(value):
            found += _walk(value, f"{prefix}{item.name}.")
        else:
            hint = hints[item.name]
            allowed = get_args(hint)[1] if get_origin(hint) is Annotated else _FINITE
            choices = get_args(hint) if get_origin(hint) is Literal else ()
            meaning = comments.get(item.name, "")
            found.append(Setting(f"{prefix}{item.name}", value, meaning, allowed, choices))
    return found


@functools.cache
def _described(section: type) -> tuple[dict[str, str], dict[str, Any]]:
    """Field name -> the comment behind it in the source, and its type."""
    found = re.findall(r"^    (\w+): .*?  # (.*)$", inspect.getsource(section), re.MULTILINE)
    return dict(found), get_type_hints(section, include_extras=True)


def apply_settings(config: Config, changes: Mapping[str, Any]) -> Config:
    """The configuration with settings changed; raises `ConfigError` with all faults at once.

    Values may be strings (from a command line) or already typed (from TOML).
    """
    known = {setting.name: setting for setting in list_settings(config)}
    problems: list[str] = []
    for name, value in changes.items():
        if name not in known:
            problems.append(_unknown(name, known))
            continue
        try:
            config = _replaced(config, name.split("."), _converted(value, known[name]))
        except ValueError as error:
            problems.append(f"{name} = {value!r}: {error}")
    if problems:
        raise ConfigError("the configuration cannot be used:", problems=problems)
    return config


def flatten(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted names and values of nested tables, as TOML gives them."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            found |= flatten(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found


def _unknown(name: str, known: Mapping[str, Setting]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if not near:
        tails = {full.rsplit(".", 1)[-1]: full for full in known}
        near = [tails[t] for t in difflib.get_close_matches(name.rsplit(".", 1)[-1], tails, n=1)]
    hint = f"did you mean {near[0]}?" if near else "`mapmyworld config` lists them all"
    return f"there is no setting {name!r}: {hint}"


def _replaced(section: Any, path: list[str], value: Any) -> Any:
    if len(path) == 1:
        return replace(section, **{path[0]: value})
    inner = _replaced(getattr(section, path[0]), path[1:], value)
    return replace(section, **{path[0]: inner})


def _converted(value: Any, setting: Setting) -> Any:
    """The value in the type of the setting's default; `ValueError` says what is expected."""
    kind = type(setting.value)
    if kind is bool:
        return _as_bool(value)
    if kind is int:
        if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
            raise ValueError("expected a whole number")
        return _within(_number(int, value, "a whole number"), setting.allowed)
    if kind is float:
        if isinstance(value, bool):
            raise ValueError("expected a number")
        return _within(_number(float, value, "a number"), setting.allowed)
    if not isinstance(value, kind):
        raise ValueError(f"expected {kind.__name__}")
    if kind is str and "\0" in value:  # which is part of no name
        raise ValueError("expected text without zero bytes")
    if setting.choices and value not in setting.choices:
        raise ValueError(f"expected {' or '.join(setting.choices)}")
    return value


def _number(kind: type, value: Any, expected: str) -> Any:
    try:
        return kind(value)
    except (TypeError, ValueError):
        raise ValueError(f"expected {expected}") from None


def _within(value: float, allowed: Range) -> float:
    if value not in allowed:
        raise ValueError(f"expected {allowed if math.isfinite(value) else _FINITE}")
    if value and math.isinf(allowed.most) and not _SMALLEST <= abs(value) <= _LARGEST:
        raise ValueError(f"expected a number from {_SMALLEST:g} to {_LARGEST:g} in size, or 0")
    return value


def _as_bool(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    if text in {"true", "yes", "on", "1"}:
        return True
    if text in {"false", "no", "off", "0"}:
        return False
    raise ValueError("expected true or false")


def as_toml(config: Config | None = None) -> str:
    """All settings as commented TOML that `--config` reads back."""
    lines: list[str] = []
    section = ""
    for setting in list_settings(config):
        head, _, name = setting.name.rpartition(".")
        if head != section:
            lines += ["", f"[{head}]"]
            section = head
        comment = f"  # {setting.meaning}" if setting.meaning else ""
        lines.append(f"{name} = {json.dumps(setting.value, ensure_ascii=False)}{comment}")
    return "\n".join(lines) + "\n"
