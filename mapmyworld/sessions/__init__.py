"""Several drives in one map: separate until a verified constraint joins them."""

from mapmyworld.sessions.extending import Extension, extend_map
from mapmyworld.sessions.merge_maps import MergedMap, merge_maps
from mapmyworld.sessions.session_maps import SessionMap, load_session_map

__all__ = ["Extension", "MergedMap", "SessionMap", "extend_map", "load_session_map", "merge_maps"]
