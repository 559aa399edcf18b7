"""How honest stated covariances are: variance components after a solution.

A solution absorbs part of every error, and most of that of the constraints which weigh most; what
is left of an edge's squared sigmas is expected to be its redundancy `trace(I - W P)`, with P the
covariance that the solution gives its residual. Forstner, "Ein Verfahren zur Schatzung von Varianz-
und Kovarianzkomponenten" (1979).

That holds at the constraints' own solution only. Poses that all scans were aligned at come from
other measurements, and leave the whole of an error: of motions between few closures, thirty times
their redundancy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmyworld.backend.descent import optimised_roughly
from mapmyworld.backend.information import NotPositiveDefiniteError, information_of
from mapmyworld.backend.predictions import predictions
from mapmyworld.backend.system import edge_chi2
from mapmyworld.graph.constraint_system import stated_system
from mapmyworld.types import Judged, Poses

_LEAST = 3.0  # redundancy of a kind, below which its residuals indicate nothing


def variance_factors(constraints: Sequence[Judged], poses: Poses, planar: bool) -> dict[str, float]:
    """Kind -> how many times larger than stated its errors are (sigmas), by accepted constraints.

    They are judged at their own solution, which lies near the `poses`. Kinds that nothing else
    checks are left out.
    """
    known = set(poses.ids.tolist())
    used = [c for c in constraints if c.accepted and {c.from_id, c.to_id} <= known]
    if not used:
        return {}
    stated = stated_system(poses.ids, poses.map_from_node, used, planar)
    system = stated.system
    solution = optimised_roughly(system, stated.start)
    try:
        information = information_of(system, solution)
    except NotPositiveDefiniteError:
        return {}
    alone = list(np.arange(len(used)).reshape(-1, 1))
    explained = [np.trace(p.covariance) for p in predictions(information, system, solution, alone)]
    left = system.dimension - np.array(explained)
    chi2 = edge_chi2(system, solution)
    kinds = np.array([str(c.kind) for c in used])
    sums = {
        str(kind): (chi2[kinds == kind].sum(), left[kinds == kind].sum())
        for kind in np.unique(kinds)
    }
    return {
        kind: float(np.sqrt(sums[kind][0] / sums[kind][1]))
        for kind in sums
        if sums[kind][1] >= _LEAST
    }
