"""Maps as Foxglove shows them."""

from formats.foxglove.map_file import FoxgloveMap, write_foxglove

__all__ = ["FoxgloveMap", "write_foxglove"]
