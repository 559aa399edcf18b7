"""One scan aligned with others, point to line, as the tracker's kernels do it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import RegistrationConfig
from mapmyworld.geometry import Array
from mapmyworld.kernels.scan_alignment import align
from mapmyworld.registration.scan_matching import FINE, Match, PreparedScan, ScanSet

_NO_PRIOR = np.zeros((3, 3))


def match_scan(
    scan: PreparedScan,
    targets: ScanSet,
    which: NDArray[np.int64],
    poses: Array,
    guess: Array,
    config: RegistrationConfig,
    *,
    prior: Array | None = None,
    prior_information: Array | None = None,
    max_distances: Array = FINE,
) -> Match:
    """Aligns a scan with targets `which` (K,) at `poses` (S, 3), from `guess` (3,).

    Gauss-Newton on distances from the targets' lines, with Cauchy weights; lines are looked for
    within `max_distances` (R,), metres, one a step. `prior` (3,) with its information (3, 3) pulls
    as another measurement; the match's own information leaves it out.
    """
    prior = guess if prior is None else prior
    prior_information = _NO_PRIOR if prior_information is None else prior_information
    out = np.zeros(16)
    sigma = config.range_sigma * np.sqrt(config.correlation)
    align(
        scan.rows, 0, len(scan.rows), targets.rows, targets.bounds[:-1], targets.bounds[1:], which,
        poses, targets.origins, guess, prior, prior_information, max_distances,
        config.residual_share, sigma, out,
    )  # fmt: skip
    xx, xy, xr, yy, yr, rr = out[3:9]
    hessian = np.array([[xx, xy, xr], [xy, yy, yr], [xr, yr, rr]])
    sigma_squared = max(config.range_sigma**2, float(out[10])) * config.correlation
    return Match(
        pose=out[:3].copy(),
        information=hessian / (sigma_squared * max(len(which), 1)),
        overlap=float(out[9]),
        residual=float(np.sqrt(out[10])),
        count=int(out[11]),
    )
