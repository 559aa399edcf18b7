"""Recorded robot logs become maps, offline.

The names below are the library for notebooks and programs. They are imported when they are first
used, so that `import mapmyworld` costs nothing.
"""

import importlib

__version__ = "0.1.0"

_PLACES = {
    "BuildResult": "mapmyworld.pipeline",
    "Built": "mapmyworld.api",
    "Config": "mapmyworld.config",
    "MapMyWorldError": "mapmyworld.errors",
    "MemoryLog": "mapmyworld.memory_log",
    "MemoryMap": "formats.database",
    "Merged": "mapmyworld.api",
    "ate": "mapmyworld.evaluation",
    "build": "mapmyworld.api",
    "build_cloud": "mapmyworld.mapping.cloud_map",
    "build_grid": "mapmyworld.mapping.occupancy",
    "cloud": "mapmyworld.conversions",
    "configured": "mapmyworld.api",
    "edit": "mapmyworld.api",
    "export": "mapmyworld.api",
    "grid_score": "mapmyworld.evaluation",
    "localise": "mapmyworld.api",
    "make_plan": "mapmyworld.sensing",
    "merge": "mapmyworld.api",
    "open_log": "formats.logs",
    "open_map": "mapmyworld.api",
    "relations_score": "mapmyworld.evaluation",
    "rpe": "mapmyworld.evaluation",
    "survey_log": "mapmyworld.sensing",
    "to_arrays": "mapmyworld.conversions",
    "to_evo": "mapmyworld.conversions",
    "to_open3d": "mapmyworld.conversions",
    "trajectory": "mapmyworld.conversions",
}
__all__ = ["__version__", *sorted(_PLACES)]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'mapmyworld' has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return __all__
