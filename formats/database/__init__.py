"""map.db: one SQLite file, RTAB-Map's tables and our own, both ways."""

from formats.database.foreign import RtabmapStore
from formats.database.opening_maps import MemoryMap, open_store
from formats.database.store import DatabaseStore

__all__ = ["DatabaseStore", "MemoryMap", "RtabmapStore", "open_store"]
