"""The library's own map in memory, by the name that older tests know."""

from formats.database import MemoryMap as MemoryStore

__all__ = ["MemoryStore"]
