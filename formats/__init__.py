"""Files in and files out, one format a file.

`open_log(paths)` reads any log, `open_map(path)` a map database: what a notebook begins with.
"""

import importlib

_PLACES = {
    "open_log": ("formats.logs", "open_log"),
    "open_map": ("formats.database", "open_store"),
}
__all__ = sorted(_PLACES)


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'formats' has no attribute {name!r}")
    module, attribute = _PLACES[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return __all__
