"""Which of a benchmark's relations between visits a map's loop closures join.

python benchmarks/laser_recall.py MAP.db LOG.relations

A relation whose moments lie 8 m of path apart or more is recalled by an accepted closure, both
ends of which lie within 2 m of path of the relation's: as far as the scans reach that a closure
compares. Counted apart by how the robot was turned, since a laser that sees half a turn sees other
walls on the way back. Printed as well are the moments at which the robot is within 1 m and 30
degrees of where it was, and what the joint alignment of all scans joins: pairs of scans of
different visits, in which a third of all points lie on lines of the other scan.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from formats.database import open_store
from formats.relation_files import read_relations
from mapmyworld.alignment.laser_pairs import field_of_view, neighbour_pairs
from mapmyworld.alignment.laser_refinement import spaced_nodes
from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar, wrap_angle
from mapmyworld.kernels.scan_pairs import pair_systems
from mapmyworld.places.laser_nodes import load_node_scans
from mapmyworld.types import CLOSURES, MapStore

Array = NDArray[np.float64]
_APART, _REACH = 8.0, 2.0  # m of path between two visits, and around a closure's ends
_NEAR, _TURNED = 1.0, 30.0  # m and degrees within which the robot is back
_ON_LINES, _AT = 1.0 / 3.0, 0.12  # share of points that join two scans, and m from a line


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("relations", type=Path)
    arguments = parser.parse_args()
    store = open_store(arguments.map)
    stamps, poses, path = drive_of(store)
    closures = closures_of(store, path)
    relations = read_relations(arguments.relations)
    ends = np.sort(np.interp(relations.stamps_ns, stamps, path), axis=1)
    turned = np.degrees(np.abs(wrap_angle(matrix_to_planar(relations.first_from_second)[:, 2])))
    apart = ends[:, 1] - ends[:, 0] >= _APART
    joined = joined_scans(store, poses, path)
    print(f"{len(closures)} closures, {len(joined)} pairs of scans; relations between visits:")
    for name, low, high in (("the same way", 0, 30), ("across", 30, 150), ("opposite", 150, 181)):
        asked = ends[apart & (turned >= low) & (turned < high)]
        by_closures, by_scans = (recalled(found, asked).mean() for found in (closures, joined))
        print(f"  {name:<14}{by_closures:7.1%} and {by_scans:7.1%} of {len(asked)}")
    pairs = returns(poses, path)
    found = recalled(closures, path[pairs])
    moments = len(np.unique(pairs[:, 1]))
    print(f"moments back: {len(np.unique(pairs[found, 1])) / moments:.1%} of {moments}")


def drive_of(store: MapStore) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps, final planar poses, and metres driven up to each node; stamps never step back."""
    solved = store.poses()
    assert solved is not None
    poses = matrix_to_planar(solved.map_from_node[solved.ids > 0])
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    stamps = np.array([node.stamp_ns for node in store.nodes()], np.int64)
    return np.maximum.accumulate(stamps), poses, path


def closures_of(store: MapStore, path: Array) -> Array:
    """(K, 2) metres of path at which accepted closures end, the lesser first."""
    kept = [c for c in store.constraints() if c.kind in CLOSURES and c.accepted]
    return np.sort(path[np.array([(c.from_id - 1, c.to_id - 1) for c in kept])], axis=1)


def joined_scans(store: MapStore, poses: Array, path: Array) -> Array:
    """(K, 2) metres of path at which scans of two visits lie that joint alignment joins."""
    config = Config()
    settings, chosen = config.odometry, spaced_nodes(poses, config)
    scans, at = load_node_scans(store, config)[1].some(chosen), poses[chosen]
    turn = 0.5 * field_of_view(scans.rows[:, 4])
    pairs = neighbour_pairs(at, settings.refine_radius, settings.refine_revisits, turn)
    driven = path[chosen[pairs]]
    pairs = pairs[driven[:, 1] - driven[:, 0] >= _APART]
    systems = np.zeros((len(pairs), 15))
    scale = config.registration.residual_share * _AT
    pair_systems(
        0, len(pairs), scans.rows, scans.bounds, scans.origins, pairs, at, _AT, scale, systems
    )
    points = np.diff(scans.bounds)[pairs].sum(axis=1)
    return np.asarray(path[chosen[pairs[systems[:, 11] >= _ON_LINES * points]]])


def recalled(closures: Array, ends: Array) -> NDArray[np.bool_]:
    """(P,) which pairs of places (P, 2), in metres of path, a closure joins."""
    distance, _ = cKDTree(closures).query(ends, p=np.inf, distance_upper_bound=_REACH)
    return np.asarray(np.isfinite(distance), np.bool_)


def returns(poses: Array, path: Array) -> NDArray[np.int64]:
    """(P, 2) rows of nodes, earlier and later, at which the robot was in one place."""
    pairs = cKDTree(poses[:, :2]).query_pairs(_NEAR, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    turned = np.degrees(np.abs(wrap_angle(poses[pairs[:, 0], 2] - poses[pairs[:, 1], 2])))
    driven = path[pairs[:, 1]] - path[pairs[:, 0]]
    return np.asarray(pairs[(turned < _TURNED) & (driven >= _APART)], np.int64)


if __name__ == "__main__":
    main()
