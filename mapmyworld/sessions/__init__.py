"""Several drives in one map: separate until a verified constraint joins them."""

from mapmyworld.sessions.merge import MergedMap, merge_maps
from mapmyworld.sessions.units import Unit, load_unit

__all__ = ["MergedMap", "Unit", "load_unit", "merge_maps"]
