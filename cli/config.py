"""`mapmyworld config`, and a configuration from its sources: defaults, a TOML file, `--set`."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import click

from cli.arguments import PATH, F, format_option
from cli.completion import settings_from
from cli.standard_streams import show_result
from formats.limits import Limits, set_limits
from formats.nested_text import read_toml
from mapmyworld.config import Config
from mapmyworld.config.settings import Setting, apply_settings, as_toml, flatten, list_settings
from mapmyworld.errors import ConfigError


def config_options(command: F) -> F:
    """`--config FILE` and `--set KEY=VALUE`, in which later ones win, as the parameter `config`."""

    @click.option(
        "--config",
        "config_path",
        type=PATH,
        help="TOML file with settings; `mapmyworld config` prints one.",
    )
    @click.option(
        "--set",
        "changes",
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=settings_from,
        help="Change one setting, e.g. --set mapping.resolution=0.025. May be repeated.",
    )
    @functools.wraps(command)
    def configured(config_path: Path | None, changes: Sequence[str], **given: Any) -> Any:
        return command(config=load_config(config_path, changes), **given)

    return cast(F, configured)


def load_config(config_path: Path | None, changes: Sequence[str]) -> Config:
    """The configuration; raises `ConfigError` with everything that is wrong at once."""
    values: dict[str, Any] = {}
    if config_path is not None:
        values |= flatten(read_toml(config_path))
    config = apply_settings(Config(), values | changed_values(changes))
    most = config.limits
    pixels, unpacked = most.image_megapixels * 1_000_000, most.unpacked_gb << 30
    set_limits(Limits(most.chunk_mb << 20, pixels, unpacked))
    return config


def changed_values(changes: Sequence[str]) -> dict[str, str]:
    """Name -> value of each `--set KEY=VALUE`, later ones winning; raises `ConfigError`."""
    values = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise ConfigError(f"--set {change}: write it as KEY=VALUE")
        values[name.strip()] = value.strip()
    return values


_IDLE = ("threads",)  # settings that change no result


def options_of(config: Config) -> list[str]:
    """`--set` of every setting that was changed, for another command."""
    return [word for now, _ in _changed(config) for word in ("--set", f"{now.name}={now.value}")]


def settings_that_differ(config: Config) -> list[list[str]]:
    """Name, value and default of every setting that was changed, as text."""
    return [
        [now.name, str(now.value), str(standard.value)]
        for now, standard in _changed(config)
        if now.name not in _IDLE
    ]


def _changed(config: Config) -> list[tuple[Setting, Setting]]:
    """Every setting that was changed, as it is and as it is by default."""
    both = zip(list_settings(config), list_settings(), strict=True)
    return [(now, standard) for now, standard in both if now.value != standard.value]


@click.command()
@format_option
def config() -> None:
    """Print every setting as commented TOML.

    \b
    mapmyworld config > my.toml      then edit it and
    mapmyworld build log.mcap --config my.toml
    """
    facts = {s.name: {"default": s.value, "meaning": s.meaning} for s in list_settings()}
    show_result(facts, as_toml().splitlines())
