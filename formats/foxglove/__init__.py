"""Maps as Foxglove shows them."""

from formats.foxglove.export import FoxgloveMap, write_foxglove

__all__ = ["FoxgloveMap", "write_foxglove"]
