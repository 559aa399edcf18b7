"""How a map was made, in RTAB-Map's parameters, and the last touch to the file."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import numpy as np

from formats.database.calibration import blob_to_eyes
from formats.database.connection import Connection, uri_of
from formats.whole_files import whole_path
from mapmyworld.errors import MapError

_FLAT = 1e-6  # m, and sine of tilt, up to which motion is planar


def parameters_to_text(parameters: Mapping[str, str]) -> str:
    """`Key:Value;...`, ascending; the separators themselves cannot be part of a value."""
    clean = {key: value.replace(";", " ").replace(",", ".") for key, value in parameters.items()}
    return ";".join(f"{key}:{clean[key]}" for key in sorted(clean))


def write_parameters(db: Connection, parameters: Mapping[str, str]) -> None:
    """Adds to those of the one Info row; keeps its count of nodes true as well."""
    (known,) = db.row("SELECT parameters FROM Info")
    pairs = (part.partition(":") for part in (known or "").split(";") if ":" in part)
    text = parameters_to_text({key: value for key, _, value in pairs} | dict(parameters))
    (last,) = db.row("SELECT COALESCE(MAX(id), 0) FROM Node")
    db.run(
        "UPDATE Info SET parameters = ?1, last_sign_added = ?2"
        " WHERE parameters IS NOT ?1 OR last_sign_added IS NOT ?2",
        (text, last),
    )


def sensor_parameters(db: Connection) -> dict[str, str]:
    """The sensors by the nodes' data: laser or camera, planar or not, with a lens or without."""
    (scans,) = db.row("SELECT EXISTS (SELECT 1 FROM Data WHERE scan IS NOT NULL)")
    poses = db.rows("SELECT tracked_from_base FROM mapmyworld_nodes")
    motion = np.array([np.frombuffer(blob, "<f8") for (blob,) in poses]).reshape(-1, 4, 4)
    flat = bool(np.abs(motion[:, 2, [0, 1, 3]]).max(initial=0.0) < _FLAT)
    found = db.row("SELECT calibration FROM Data WHERE calibration IS NOT NULL LIMIT 1")
    cameras = blob_to_eyes(found[0], "calibration") if found else ()
    bent = any(camera.distortion.any() for camera, _ in cameras)
    return {
        "Grid/Sensor": "0" if scans else "1",
        "Reg/Force3DoF": str(flat).lower(),
        "Reg/Strategy": "1" if scans else "0",
        "Rtabmap/ImagesAlreadyRectified": str(not bent).lower(),
    }


def compact(path: Path) -> None:
    """Writes the file anew, pages in order, and puts it in place in one step.

    The same rows then give the same bytes, however often the build was interrupted. Raises
    `MapError` where it cannot be written.
    """
    try:
        with whole_path(path) as fresh:
            fresh.unlink(missing_ok=True)
            with closing(sqlite3.connect(uri_of(path), uri=True)) as source:
                source.execute("VACUUM INTO ?", (uri_of(fresh),))
            with closing(sqlite3.connect(fresh)) as packed:
                packed.execute("PRAGMA schema_version = 1")  # SQLite's count of earlier packings
                packed.execute("PRAGMA user_version = 0")
    except (sqlite3.Error, OSError) as error:
        raise MapError(f"{path}: complete, but could not be packed ({error})") from error
