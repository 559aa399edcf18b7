"""Features followed over the whole map, adjusted together with the poses that saw them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, invert, se3_adjoint, transform_points
from mapmyworld.graph.bundle import Bundle, RelativePoses
from mapmyworld.graph.feature_graph import Adjusted, adjust_features
from mapmyworld.graph.sighting_errors import with_measured_errors
from mapmyworld.parallel import in_threads
from mapmyworld.places.node_images import NodeImages
from mapmyworld.registration.image_pairs import match_by_pose
from mapmyworld.registration.views import View
from mapmyworld.registration.visual import Sightings, inliers
from mapmyworld.types import Constraint, ImageMatch, MapStore, Poses, Progress

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_FLAT = 1e8  # information out of the plane of a robot that cannot leave it
_ALIKE = 10.0  # sightings that err alike, by mounting, lens and depth, and tell as much as one
_SAME = 1 << 16  # more features than an image has


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedMap:
    """Poses after an adjustment with all features, and what it came to."""

    poses: Poses
    features: int
    sightings: int
    moved: float
    """m, root mean square over the nodes."""


def adjust_map(
    store: MapStore, poses: Poses, config: Config, progress: Progress, *, planar: bool
) -> AdjustedMap | None:
    """Poses and features in one graph, with every motion that no image told; None without images.

    Features are those of verified pairs of images; one that was seen by several nodes is one
    node of the graph. Closures by images are not used again: their matches are.
    """
    images = NodeImages(store, config, progress)
    row_of = {int(i): row for row, i in enumerate(poses.ids)}
    rows = np.array([row_of.get(node.id, -1) for node in images.nodes], np.int64)
    index_of = {node.id: k for k, node in enumerate(images.nodes) if rows[k] >= 0}
    constraints = [c for c in store.constraints() if c.accepted]
    pairs = [
        (index_of[c.from_id], index_of[c.to_id])
        for c in constraints
        if isinstance(c.source, ImageMatch) and c.from_id in index_of and c.to_id in index_of
    ]
    if not pairs:
        return None
    progress.stage("features as nodes", len(pairs), "pairs")
    found = list(_followed(images, pairs, poses.map_from_node[rows], config, progress))
    tracks = _tracks(np.concatenate(found))
    mounts = _mounts(images, rows, len(poses.ids))
    motions = _motions(constraints, row_of, mounts, planar=planar)
    bundle = _bundle(images, rows, poses.map_from_node @ mounts, tracks, motions)
    expected = adjust_features(bundle).bundle
    adjusted = adjust_features(with_measured_errors(expected))
    return _adjusted_poses(poses, adjusted, mounts, planar=planar)


def _followed(
    images: NodeImages,
    pairs: Sequence[tuple[int, int]],
    places: Array,
    config: Config,
    progress: Progress,
) -> Iterator[Indices]:
    """For each pair of nodes the features (N, 2) that are the same, numbered over all nodes."""

    def follow(item: tuple[int, int, View, View]) -> Indices:
        i, j, a, b = item
        motion = between(places[i], places[j])
        points = transform_points(a.camera.base_from_camera, a.camera_points())
        mine, theirs = match_by_pose(a, b, points, motion, config.visual.closure_radius, config)
        sightings = Sightings(points[mine], b.seen[theirs], b.sigmas[theirs])
        pose = motion @ b.camera.base_from_camera
        agreed = inliers(pose, sightings, 2.0 * config.visual.inlier_sigmas)
        return np.column_stack([i * _SAME + mine[agreed], j * _SAME + theirs[agreed]])

    followed = in_threads(follow, _loaded(images, pairs), config.threads)
    for done, matched in enumerate(followed, start=1):
        progress.update(done)
        yield matched


def _loaded(
    images: NodeImages, pairs: Sequence[tuple[int, int]]
) -> Iterator[tuple[int, int, View, View]]:
    for i, j in sorted(set(pairs)):
        a, b = images.view(i), images.view(j)
        if a is not None and b is not None:
            yield i, j, a, b


def _tracks(matched: Indices) -> tuple[Indices, Indices, Indices]:
    """Node, feature and point (M,) of every sighting, sorted by point.

    What is linked is one point. Where that would be two features of one image, none of them is.
    """
    names, linked = np.unique(matched, return_inverse=True)
    linked = linked.reshape(-1, 2)
    count = len(names)
    graph = scipy.sparse.coo_matrix((np.ones(len(linked)), linked.T), shape=(count, count))
    _, point = scipy.sparse.csgraph.connected_components(graph, directed=False)
    node = names // _SAME
    _, first, times = np.unique(
        point * (int(node.max(initial=0)) + 1) + node, return_inverse=True, return_counts=True
    )
    twice = np.zeros(int(point.max(initial=-1)) + 1, np.bool_)
    twice[point[times[first] > 1]] = True
    kept = np.flatnonzero(~twice[point])
    kept = kept[np.lexsort((names[kept], point[kept]))]
    _, numbers = np.unique(point[kept], return_inverse=True)
    return node[kept], names[kept] % _SAME, numbers.astype(np.int64)


def _mounts(images: NodeImages, rows: Indices, count: int) -> Array:
    """base_from_camera (N, 4, 4) of every node; where none looked, the base stands for one."""
    mounts = np.tile(np.eye(4), (count, 1, 1))
    for k, row in enumerate(rows.tolist()):
        view = images.view(k) if row >= 0 else None
        if view is not None:
            mounts[row] = view.camera.base_from_camera
    return mounts


def _bundle(
    images: NodeImages,
    rows: Indices,
    cameras: Array,
    tracks: tuple[Indices, Indices, Indices],
    motions: RelativePoses | None,
) -> Bundle:
    """The features at the means of where their depths put them, and all that was seen of them.

    Nodes that share no feature are there as well: a motion that wheels measured in two parts,
    to such a node and from it, ties the nodes on both sides.
    """
    node_of, feature_of, point_of = tracks
    seen, sigmas = np.empty((len(node_of), 3)), np.empty((len(node_of), 3))
    points = np.empty((len(node_of), 3))
    for node in np.unique(node_of).tolist():
        view = images.view(node)
        assert view is not None
        mine = np.flatnonzero(node_of == node)
        chosen = feature_of[mine]
        seen[mine], sigmas[mine] = view.seen[chosen], view.sigmas[chosen]
        points[mine] = transform_points(cameras[rows[node]], view.camera_points()[chosen])
    deep = np.isfinite(points[:, 2])
    count = int(point_of.max(initial=-1)) + 1
    total = np.zeros((count, 3))
    np.add.at(total, point_of[deep], points[deep])
    mean = total / np.maximum(np.bincount(point_of[deep], minlength=count), 1)[:, None]
    fixed = np.arange(len(cameras)) == 0
    return Bundle(cameras, fixed, mean, rows[node_of], point_of, seen, sigmas, motions)


def _motions(
    constraints: Sequence[Constraint], row_of: dict[int, int], mounts: Array, *, planar: bool
) -> RelativePoses | None:
    """What wheels, lasers and people said of the motion between nodes, and of landmarks."""
    kept = [
        c
        for c in constraints
        if not isinstance(c.source, ImageMatch)
        and c.from_id != c.to_id
        and c.from_id in row_of
        and c.to_id in row_of
    ]
    if not kept:
        return None
    first = np.array([row_of[c.from_id] for c in kept])
    second = np.array([row_of[c.to_id] for c in kept])
    measured = np.stack([c.from_from_to for c in kept])
    information = np.stack([c.information for c in kept])
    if planar:
        level = np.array([c.to_id > 0 for c in kept])
        for axis in (0, 1, 5):  # roll, pitch, z
            information[level, axis, axis] += _FLAT
    adjoint = se3_adjoint(mounts[second])
    turned = np.swapaxes(adjoint, 1, 2) @ information @ adjoint
    moved = invert(mounts[first]) @ measured @ mounts[second]
    return RelativePoses(first, second, moved, _ALIKE * turned)


def _adjusted_poses(
    poses: Poses, adjusted: Adjusted, mounts: Array, *, planar: bool
) -> AdjustedMap:
    """The adjusted cameras as poses of their nodes."""
    placed = adjusted.bundle.cameras @ invert(mounts)
    if planar:
        nodes = poses.ids > 0
        placed[nodes] = planar_to_matrix(matrix_to_planar(placed[nodes]))
    change = np.linalg.norm(placed[:, :3, 3] - poses.map_from_node[:, :3, 3], axis=1)
    return AdjustedMap(
        Poses(poses.ids, placed, poses.covariances),
        len(adjusted.bundle.points),
        len(adjusted.bundle.point_of),
        float(np.sqrt(np.mean(change**2))),
    )
