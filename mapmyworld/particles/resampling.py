"""When and how particles are replaced by others."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_QUANTILE = 2.33  # of the normal distribution: 99 %


def effective_sample_size(w: NDArray[np.float64]) -> float:
    """1 / sum of w^2, w (P,): P when all are equal, 1 when one particle has all the weight."""
    return float(1.0 / np.sum(w * w))


def low_variance_sampler(w: NDArray[np.float64], count: int, r: float) -> NDArray[np.int64]:
    """(C,) ancestors of the next particles by weights w (P,); C is `count`.

    Thrun, Burgard, Fox 2005, table 4.4: a comb of `count` equal steps over the cumulated weights,
    so that a particle of weight w is drawn count * w times, rounded up or down. `r` in [0, 1) is
    the one random number it takes.
    """
    comb = (np.arange(count) + r) / count
    cumulated = np.cumsum(w)
    return np.minimum(np.searchsorted(cumulated / cumulated[-1], comb, "right"), len(w) - 1)


def kld_sample_size(bins: int, error: float) -> int:
    """Particles after which the sampled distribution over `bins` bins is `error` from the true one.

    In Kullback-Leibler divergence, with a certainty of 99 % (Fox, "Adapting the sample size in
    particle filters through KLD-sampling", 2003, by the Wilson-Hilferty approximation of the
    chi-squared distribution).
    """
    if bins < 2:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * _QUANTILE) ** 3)
