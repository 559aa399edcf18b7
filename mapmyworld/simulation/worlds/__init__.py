"""The worlds that come with the program, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mapmyworld.errors import WorldError
from mapmyworld.simulation.world import World
from mapmyworld.simulation.worlds.apartment import APARTMENT
from mapmyworld.simulation.worlds.corridor import CORRIDOR
from mapmyworld.simulation.worlds.hall import HALL
from mapmyworld.simulation.worlds.office import OFFICE

WORLDS: Mapping[str, World] = MappingProxyType(
    {world.name: world for world in (APARTMENT, HALL, OFFICE, CORRIDOR)}
)


def find_world(name: str) -> World:
    """The world of that name; raises `WorldError` with the names there are."""
    if name not in WORLDS:
        raise WorldError(f"there is no world {name!r}: choose one of {', '.join(WORLDS)}")
    return WORLDS[name]
