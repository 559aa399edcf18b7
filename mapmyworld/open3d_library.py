"""Open3D, which only meshes need: loaded when one is wanted, or what to install."""

from __future__ import annotations

from typing import Any

from mapmyworld.errors import MissingDependencyError

PACKAGES = "libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0 libgomp1"
"""System packages whose libraries a slim server or container lacks."""


def import_open3d(wanted: str) -> Any:
    """The library; raises `MissingDependencyError` where it does not load: what to install."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"{wanted} needs Open3D, which does not load ({error}): on a bare system "
            f"`apt-get install {PACKAGES}`; where it is not there at all, reinstall mapmyworld"
        ) from None
    return open3d
