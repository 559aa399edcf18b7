"""The best particle's path, smoothed: all its scans aligned with each other.

A particle fixes each pose when it passes, with the map of that moment, and of thirty the best one
comes back to a place some decimetres off. Offline the whole path is known, so the posterior over
paths, p(x_1:t | z_1:t, u_1:t), can be climbed on from there. The best particle has decided which
scans saw the same surfaces; where these lie follows from all of them at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapmyworld.alignment.joint_alignment import align_in_rounds
from mapmyworld.alignment.laser_pairs import neighbour_pairs
from mapmyworld.backend.system import System, number_free
from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.registration.scan_matching import FINE, prepare_scans
from mapmyworld.types import Progress, Scan


def smooth_path(
    path: Array, motions: Array, information: Array, scans: Sequence[Scan], config: Config,
    progress: Progress,
) -> Array:  # fmt: skip
    """The `path` of scans, refined, (K, 3) both.

    The motions (K - 1, 3) between them are known to `information` (K - 1, 3, 3).
    """
    progress.stage("refine", len(FINE), "rounds")
    every, settings = np.arange(len(path)), config.odometry
    system = System(True, every[:-1], every[1:], motions, information, number_free(every == 0))

    def pairs_at(poses: Array) -> NDArray[np.int64]:
        return neighbour_pairs(poses, settings.refine_radius, settings.refine_revisits)

    prepared = prepare_scans(scans, config.registration)
    return align_in_rounds(prepared, system, path, pairs_at, config, progress).poses
