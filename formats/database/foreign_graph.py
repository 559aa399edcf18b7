"""RTAB-Map's links and optimised poses as constraints and poses of ours."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

import numpy as np

from formats.database.blobs import blob_to_information, blob_to_matrix, blob_to_pose, orthonormal
from formats.database.links import KINDS
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import invert, transforms_of_rows
from mapmyworld.types import OF_ONE_NODE, ConstraintKind, Given, Judged, Poses

SELECT_LINKS = "SELECT from_id, to_id, type, information_matrix, transform FROM Link ORDER BY rowid"
_GRAVITY = 9
_NAMES = {3: "closure in time", 6: "merged neighbour"}
_MANY = 20  # problems listed in full; the rest are counted


def constraints_from_links(
    rows: Sequence[tuple[Any, ...]], nodes: Set[int]
) -> tuple[tuple[Judged, ...], tuple[str, ...]]:
    """Constraints in the order of the rows, and a line on each link that was left out.

    Of the two directions of a pair the first one is kept, turned forward in time.
    """
    found: dict[tuple[int, int, int], Judged] = {}
    problems: list[str] = []
    for row in rows:
        if row[2] == _GRAVITY:
            continue  # an orientation, which our graph takes from the imu
        key = _key(row)
        if key in found:
            continue
        try:
            constraint = _constraint(row, nodes)
        except MapError as error:
            problems.append(str(error))
            continue
        if constraint is not None:
            found[key] = constraint
    shown = problems[:_MANY]
    if len(problems) > _MANY:
        shown.append(f"{len(problems) - _MANY} more links were left out")
    return tuple(found.values()), tuple(shown)


def _key(row: tuple[Any, ...]) -> tuple[int, int, int]:
    """The same for both directions of a link."""
    from_id, to_id, number = row[:3]
    return (to_id, from_id, number) if 0 < to_id < from_id else (from_id, to_id, number)


def _constraint(row: tuple[Any, ...], nodes: Set[int]) -> Judged | None:
    """A row's constraint, turned forward; None for a link of merged-away nodes."""
    from_id, to_id, number, information, transform = row
    what = f"link {from_id} to {to_id} of type {number}"
    kind = KINDS.get(number)
    if kind is None:
        raise MapError(f"{what}: an unknown type, left out")
    motion = blob_to_pose(transform, what)
    if motion is None:
        return None  # RTAB-Map's "null link": its node was merged into another
    if (from_id == to_id) != (kind in OF_ONE_NODE):
        raise MapError(f"{what}: a node linked to itself, left out")
    if (to_id < 0) != (kind is ConstraintKind.LANDMARK):
        raise MapError(f"{what}: only landmarks have negative ids, left out")
    if from_id not in nodes or (to_id > 0 and to_id not in nodes):
        raise MapError(f"{what}: there is no such node, left out")
    matrix = blob_to_information(information, what)
    if not (np.diag(matrix) > 0).all():
        raise MapError(f"{what}: its information is not positive, left out")
    if 0 < to_id < from_id:
        from_id, to_id, motion = to_id, from_id, invert(motion)
    named = f" as a {_NAMES[number]}" if number in _NAMES else ""
    return Judged(from_id, to_id, kind, motion, matrix, Given(f"stored by RTAB-Map{named}"))


def poses_from_blobs(ids_blob: bytes | None, poses_blob: bytes | None, what: str) -> Poses | None:
    """`opt_ids` and `opt_poses`, nodes first; None where there are none.

    Raises `MapError` where they are damaged; `what` names them.
    """
    ids = blob_to_matrix(ids_blob, f"{what}: opt_ids")
    floats = blob_to_matrix(poses_blob, f"{what}: opt_poses")
    if ids is None or floats is None:
        return None
    if ids.dtype != np.int32 or floats.dtype != np.float32 or floats.size != 12 * ids.size:
        raise MapError(
            f"{what}: {ids.size} optimised ids do not fit {floats.size} numbers of poses"
        )
    numbers = ids.ravel().astype(np.int64)
    poses = transforms_of_rows(np.asarray(floats, np.float32))
    if not np.isfinite(poses).all():
        raise MapError(f"{what}: optimised poses that are not finite")
    order = np.lexsort((np.abs(numbers), numbers < 0))
    return Poses(numbers[order], orthonormal(poses)[order])
