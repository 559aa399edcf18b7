"""The submap around a node: what the laser saw along a section of the path, as if from there."""

from __future__ import annotations

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array, Index
from mapmyworld.geometry.planar import between_planar
from mapmyworld.places.laser_nodes import LaserNodes
from mapmyworld.registration.place_evidence import Place
from mapmyworld.registration.scan_matching import FINE, Match, PreparedScan, match_scan
from mapmyworld.registration.submaps import Submap, rows_of

_NO_PRIOR = np.diag([1e-3, 1e-3, 1e-3])


def submap_members(nodes: LaserNodes, middle: int, config: Config, size: int = 1) -> Index:
    """(K,) nodes around one along the path, at most nine; of `size` times as long a section."""
    half, path, count = size * config.places.laser_submap, nodes.path, 4 * size
    first = int(np.searchsorted(path, path[middle] - half))
    last = int(np.searchsorted(path, path[middle] + half, side="right")) - 1
    before = {first + k * (middle - first) // count for k in range(count + 1)}
    after = {middle + k * (last - middle) // count for k in range(count + 1)}
    return np.array(sorted(before | after), np.int64)


def submap_of(nodes: LaserNodes, members: Index, origin: int, size: int = 1) -> Submap:
    """The submap of some nodes (K,), in the frame of the node `origin`."""
    poses = between_planar(nodes.poses[origin], nodes.poses[members])
    return Submap.of(nodes.scans.some(members), poses, size)


def place_around(nodes: LaserNodes, middle: int, config: Config, size: int = 1) -> Place:
    """The place around a node, `size` times as long as others."""
    return Place.of(submap_of(nodes, submap_members(nodes, middle, config, size), middle, size))


def match_submaps(
    nodes: LaserNodes, a: int, b: int, guess: Array, config: Config, size: int = 1,
    prior: Array = _NO_PRIOR,
) -> Match:  # fmt: skip
    """The scans around b, as one, aligned with those around a, from `guess` (3,) of a_from_b.

    Both `size` times as long as others; the guess has a `prior` information (3, 3).
    """
    targets, members = (submap_members(nodes, k, config, size) for k in (a, b))
    return match_members(nodes, (a, targets), (b, members), guess, config, 2 * size, prior)


def match_members(
    nodes: LaserNodes, target: tuple[int, Index], other: tuple[int, Index], guess: Array,
    config: Config, step: int = 2, prior: Array = _NO_PRIOR,
) -> Match:  # fmt: skip
    """Scans of some nodes, as one, aligned with those of others.

    A node and the nodes of its submap, (K,) both; `guess` (3,) is where the `other` node lies in
    the frame of the `target` node, with a `prior` information (3, 3).
    """
    (a, targets), (b, members) = target, other
    return match_scan(
        _joined(nodes, b, members, step), nodes.scans.some(targets),
        between_planar(nodes.poses[a], nodes.poses[targets]), guess, config.registration,
        prior_information=prior, max_distances=np.concatenate([[0.4, 0.3], FINE]),
    )  # fmt: skip


def _joined(nodes: LaserNodes, b: int, members: Index, step: int) -> PreparedScan:
    """Some of the members' points, in b's frame; their bearings serve no search."""
    scans = nodes.scans.some(members)
    rows, of = rows_of(scans, step)
    b_from_m = between_planar(nodes.poses[b], nodes.poses[members])
    c, s = np.cos(b_from_m[:, 2])[of], np.sin(b_from_m[:, 2])[of]
    x, y, nx, ny = rows[:, :4].T.astype(np.float64)
    rows[:, 0], rows[:, 1] = b_from_m[of, 0] + c * x - s * y, b_from_m[of, 1] + s * x + c * y
    rows[:, 2], rows[:, 3] = c * nx - s * ny, s * nx + c * ny
    return PreparedScan(rows, scans.origins[int(np.searchsorted(members, b))])
