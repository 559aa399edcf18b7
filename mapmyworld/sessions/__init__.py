"""Several drives in one map: separate until a verified constraint joins them."""

from mapmyworld.sessions.extending import Extension, extend_map
from mapmyworld.sessions.merge import MergedMap, merge_maps
from mapmyworld.sessions.units import Unit, load_unit

__all__ = ["Extension", "MergedMap", "Unit", "extend_map", "load_unit", "merge_maps"]
