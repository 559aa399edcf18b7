"""How sure we are that a minimum is the global one."""

from __future__ import annotations

from mapmyworld.geometry import Array
from mapmyworld.graph.system import System, edge_chi2


def certainty_of(system: System, poses: Array, converged: bool) -> str:
    """An honest sentence about the minimum: what the residuals say, which is no proof.

    At the true solution half of twice the cost is expected to be the number of degrees of
    freedom, if the covariances are right; a wrong minimum costs much more.
    """
    if not converged:
        return "not converged: raise graph.iterations"
    freedom = system.dimension * len(system.tails) - system.size
    if freedom <= 0:
        return "as many unknowns as measurements: nothing to check against"
    ratio = float(edge_chi2(system, poses).sum()) / freedom
    return (
        f"converged; squared sigmas are {ratio:.3g} times what the covariances predict "
        f"({'no sign of a wrong minimum' if ratio < 2.0 else 'wrong minimum or wrong covariances'})"
        "; not proven to be the global minimum"
    )
