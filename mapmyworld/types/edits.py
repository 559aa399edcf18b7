"""What a person states about a graph, over and above what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class EditAction(StrEnum):
    """What an edit does to the graph."""

    ACCEPT = "accept"
    REJECT = "reject"
    ADD = "add"
    PIN = "pin"
    PRIOR = "prior"


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """One statement, with the reason that the person gave."""

    action: EditAction
    from_id: int
    to_id: int
    """The same as `from_id` for a pin or a prior."""
    reason: str
    kind: str = ""
    """Restricts accept and reject to constraints of one kind; empty = all between the nodes."""
    motion: NDArray[np.float64] | None = None
    """(4, 4): i_from_j of an added constraint; map_from_node of a prior or a pin. A pin
    without one stays where the node is."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6), rotation first, of an added constraint or a prior."""
