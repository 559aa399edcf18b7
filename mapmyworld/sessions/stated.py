"""What people stated of several maps, for the map that they become."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.geometry.rigid import between, invert, se3_adjoint
from mapmyworld.graph.edited_constraints import covariance_of, edits_from_json
from mapmyworld.sessions.copying import Placed
from mapmyworld.types.edits import Edit, EditAction

_PLACES = {EditAction.PIN, EditAction.PRIOR}


def copied_edits(placed: Sequence[Placed]) -> tuple[Edit, ...]:
    """Every session map's edits under the new ids.

    Priors and pins say where nodes are in their own session map's frame. That of the first one is
    the merged map's; of the others they still say how their nodes lie to each other.
    """
    return tuple(edit for k, item in enumerate(placed) for edit in _of(item, is_first=k == 0))


def _of(item: Placed, *, is_first: bool) -> Iterator[Edit]:
    edits = [
        replace(edit, from_id=item.new_id(edit.from_id), to_id=item.new_id(edit.to_id))
        for edit in edits_from_json(item.session_map.store.get("edits"))
    ]
    places = [] if is_first else [edit for edit in edits if edit.action in _PLACES]
    yield from (edit for edit in edits if edit not in places)
    yield from (_between(places[0], other) for other in places[1:])


def _between(first: Edit, other: Edit) -> Edit:
    """How one node lies to another, where both were stated in one frame."""
    assert first.motion is not None
    assert other.motion is not None
    motion = between(first.motion, other.motion)
    carry = se3_adjoint(invert(motion))
    covariance = carry @ covariance_of(first) @ carry.T + covariance_of(other)
    return Edit(
        EditAction.ADD, first.from_id, other.from_id, f"{first.reason}; {other.reason}", "",
        motion, np.asarray(covariance),
    )  # fmt: skip
