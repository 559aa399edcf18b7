"""Where a robot was in a finished map; the map is never changed."""

from mapmyworld.localisation.log_localisation import localise_log

__all__ = ["localise_log"]
