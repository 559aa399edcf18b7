"""Settings by name: complete, documented, refused when wrong, the same after a round trip."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings, as_toml, flatten, list_settings
from mapmyworld.errors import ConfigError
from mapmyworld.simulation import SimulationSettings


@pytest.mark.parametrize("config", [Config(), SimulationSettings()])
def test_every_setting_says_what_it_means(config: Any) -> None:
    silent = [setting.name for setting in list_settings(config) if not setting.meaning]
    assert silent == []


def test_the_printed_toml_gives_the_same_configuration() -> None:
    changed = apply_settings(Config(), {"sensing.node_distance": "0.25", "seed": 7})
    values = flatten(tomllib.loads(as_toml(changed)))
    restored = apply_settings(Config(), values)
    assert list_settings(restored) == list_settings(changed)
    assert restored.sensing.node_distance == 0.25


def test_unknown_names_and_wrong_values_are_all_reported_at_once_with_a_suggestion() -> None:
    with pytest.raises(ConfigError) as error:
        apply_settings(Config(), {"sensing.node_distanc": 1, "seed": "many", "nonsense": 3})
    text = str(error.value)
    assert "did you mean sensing.node_distance?" in text
    assert "seed = 'many': expected a whole number" in text
    assert "nonsense" in text


@pytest.mark.parametrize("value", [True, "nan", [], "0.1m"])
def test_values_of_the_wrong_type_are_refused(value: object) -> None:
    with pytest.raises(ConfigError):
        apply_settings(Config(), {"sensing.node_distance": value})


@pytest.mark.parametrize(("text", "expected"), [("true", True), ("off", False), ("1", True)])
def test_switches_are_read_from_text(text: str, expected: bool) -> None:
    assert apply_settings(Config(), {"sensing.use_images": text}).sensing.use_images is expected


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("mapping.resolution", "0", "more than 0"),
        ("mapping.resolution", "inf", "a finite number"),
        ("mapping.hit_probability", 2, "between 0.5 and 1"),
        ("storage.image_quality", 101, "from 1 to 100"),
        ("threads", -1, "0 or more"),
        ("seed", float("inf"), "a whole number"),
        ("sensing.cloud_lowest", "nan", "a finite number"),
        ("mapping.resolution", "1e-300", "a number from 1e-15 to 1e"),
        ("odometry.contradiction", 1e300, "a number from 1e-15 to 1e"),
        ("graph.iterations", 10**23, "a number from 1e-15 to 1e"),
        ("seed", 1 << 64, "from 0 to"),
        ("sensing.scan_offset", 1e10, "from -1e"),
        ("places.vocabulary", "\0", "text without zero bytes"),
        ("storage.depth_codec", "rvl", "png or float"),
        ("storage.image_codec", "JPEG", "jpeg or png"),
    ],
)
def test_a_value_out_of_range_is_refused_with_the_range(
    name: str, value: object, expected: str
) -> None:
    with pytest.raises(ConfigError, match=f"expected {expected}"):
        apply_settings(Config(), {name: value})


def test_every_number_has_a_range_that_holds_its_default() -> None:
    numbers = [setting for setting in list_settings() if type(setting.value) in (int, float)]
    assert [setting.name for setting in numbers if setting.value not in setting.allowed] == []
    open_ended = {setting.name for setting in numbers if str(setting.allowed) == "a finite number"}
    assert open_ended == {  # heights may lie below the base
        "sensing.cloud_lowest",
        "sensing.cloud_highest",
        "visual.obstacle_lowest",
        "visual.obstacle_highest",
    }
