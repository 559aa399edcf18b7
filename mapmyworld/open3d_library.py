"""Open3D, which only meshes need: loaded when one is wanted, or what to install."""

from __future__ import annotations

from typing import Any

from mapmyworld.errors import MissingDependencyError

PACKAGES = "libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0 libgomp1"
"""System packages whose libraries a slim server or container lacks."""


def import_open3d(wanted: str) -> Any:
    """The library; raises what `missing_open3d` says where it does not load."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise missing_open3d(wanted, str(error)) from None
    return open3d


def missing_open3d(wanted: str, why: str) -> MissingDependencyError:
    """What to install for what was wanted, and why Open3D did not load."""
    return MissingDependencyError(
        f"{wanted} needs Open3D, which does not load ({why}): on a bare system "
        f"`apt-get install {PACKAGES}`; where it is not there at all, reinstall mapmyworld"
    )
