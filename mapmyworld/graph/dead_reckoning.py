"""Dead reckoning along trusted edges, with the covariance that it gathers."""

from __future__ import annotations

import numpy as np

from mapmyworld.backend.connected_components import Index, components
from mapmyworld.backend.starts import along_tree, spanning_tree
from mapmyworld.geometry import Array
from mapmyworld.geometry.planar import planar_adjoint
from mapmyworld.geometry.rigid import se3_adjoint
from mapmyworld.graph.consistency import Odometry


def reckon(
    planar: bool, guess: Array, tails: Index, heads: Index, measured: Array, information: Array
) -> Odometry:
    """Poses and covariances of all N nodes by the trusted edges between them alone.

    These lead from `tails` (E,) to `heads` (E,), with `measured` (E, 3 or 4, 4) as tail_from_head
    and its `information` (E, d, d); roots keep their `guess` (N, 3 or 4, 4).
    """
    tree = spanning_tree(planar, len(guess), tails, heads, measured)
    poses = along_tree(planar, guess, tree.parents, tree.motions)
    adjoint = planar_adjoint(poses) if planar else se3_adjoint(poses)
    size = 3 if planar else 6
    step = np.zeros((len(guess), size, size))
    moved = tree.edges >= 0
    # An edge's covariance lives in the frame of the node that it points to.
    end = adjoint[heads[tree.edges[moved]]]
    step[moved] = end @ np.linalg.inv(information[tree.edges[moved]]) @ np.swapaxes(end, 1, 2)
    parents = tree.parents
    while not np.array_equal(parents, parents[parents]):
        step = step + step[parents]
        parents = parents[parents]
    return Odometry(poses, step, components(len(guess), tails, heads))
