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
from mapmyworld.parallel import in_threads
from mapmyworld.places.node_images import NodeImages
from mapmyworld.registration.image_pairs import match_by_pose
from mapmyworld.registration.views import View
from mapmyworld.registration.visual import Sightings, inliers
from mapmyworld.types import Constraint, MapStore, Poses, Progress

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
    row_of = {int(i): k for k, i in enumerate(poses.ids)}
    index_of = {node.id: k for k, node in enumerate(images.nodes) if node.id in row_of}
    constraints = [c for c in store.constraints() if c.accepted]
    pairs = [
        (index_of[c.from_id], index_of[c.to_id])
        for c in constraints
        if "matches" in c.evidence and c.from_id in index_of and c.to_id in index_of
    ]
    if not pairs:
        return None
    progress.stage("features as nodes", len(pairs), "pairs")
    places = np.stack([poses.map_from_node[row_of.get(n.id, 0)] for n in images.nodes])
    found = list(_followed(images, pairs, places, config, progress))
    camera_of, feature_of, point_of = _tracks(np.concatenate(found))
    used = np.unique(camera_of)
    motions = _motions(constraints, index_of, images, used, planar=planar)
    bundle = _bundle(images, places, used, camera_of, feature_of, point_of, motions)
    adjusted = adjust_features(bundle)
    return _adjusted_poses(poses, images, used, adjusted, row_of, planar=planar)


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


def _bundle(
    images: NodeImages,
    places: Array,
    used: Indices,
    camera_of: Indices,
    feature_of: Indices,
    point_of: Indices,
    motions: RelativePoses | None,
) -> Bundle:
    """The features at the means of where their depths put them, and all that was seen of them."""
    cameras = np.empty((len(used), 4, 4))
    seen, sigmas = np.empty((len(camera_of), 3)), np.empty((len(camera_of), 3))
    points = np.empty((len(camera_of), 3))
    for k, node in enumerate(used.tolist()):
        view = images.view(node)
        assert view is not None
        mine = np.flatnonzero(camera_of == node)
        cameras[k] = places[node] @ view.camera.base_from_camera
        chosen = feature_of[mine]
        seen[mine], sigmas[mine] = view.seen[chosen], view.sigmas[chosen]
        points[mine] = transform_points(cameras[k], view.camera_points()[chosen])
    deep = np.isfinite(points[:, 2])
    count = int(point_of.max(initial=-1)) + 1
    total = np.zeros((count, 3))
    np.add.at(total, point_of[deep], points[deep])
    mean = total / np.maximum(np.bincount(point_of[deep], minlength=count), 1)[:, None]
    local = np.searchsorted(used, camera_of)
    fixed = np.arange(len(used)) == 0
    return Bundle(cameras, fixed, mean, local, point_of, seen, sigmas, motions)


def _motions(
    constraints: Sequence[Constraint],
    index_of: dict[int, int],
    images: NodeImages,
    used: Indices,
    *,
    planar: bool,
) -> RelativePoses | None:
    """What wheels, lasers and people said of the motion between the cameras in use."""
    in_use = set(used.tolist())
    kept = [
        (index_of[c.from_id], index_of[c.to_id], c)
        for c in constraints
        if "matches" not in c.evidence
        and c.from_id != c.to_id
        and index_of.get(c.from_id) in in_use
        and index_of.get(c.to_id) in in_use
    ]
    if not kept:
        return None
    first = np.searchsorted(used, [a for a, _, _ in kept])
    second = np.searchsorted(used, [b for _, b, _ in kept])
    mounts = [_mount(images, node) for node in used.tolist()]
    ends = np.stack([mounts[k] for k in second])
    starts = np.stack([mounts[k] for k in first])
    measured = np.stack([c.from_from_to for _, _, c in kept])
    information = np.stack([c.information for _, _, c in kept])
    if planar:
        for axis in (0, 1, 5):  # roll, pitch, z
            information[:, axis, axis] += _FLAT
    adjoint = se3_adjoint(ends)
    turned = np.swapaxes(adjoint, 1, 2) @ information @ adjoint
    return RelativePoses(first, second, invert(starts) @ measured @ ends, _ALIKE * turned)


def _mount(images: NodeImages, node: int) -> Array:
    view = images.view(node)
    assert view is not None
    return view.camera.base_from_camera


def _adjusted_poses(
    poses: Poses,
    images: NodeImages,
    used: Indices,
    adjusted: Adjusted,
    row_of: dict[int, int],
    *,
    planar: bool,
) -> AdjustedMap:
    """The adjusted cameras as poses of their nodes; other nodes go with the one before them."""
    placed = poses.map_from_node.copy()
    correction, at = np.eye(4), 0
    for k, node in enumerate(used.tolist()):
        row = row_of[images.nodes[node].id]
        placed[at:row] = correction @ poses.map_from_node[at:row]
        bundle = adjusted.bundle
        pose = bundle.cameras[k] @ invert(_mount(images, node))
        placed[row] = planar_to_matrix(matrix_to_planar(pose)) if planar else pose
        correction, at = placed[row] @ invert(poses.map_from_node[row]), row + 1
    placed[at:] = correction @ poses.map_from_node[at:]
    change = np.linalg.norm(placed[:, :3, 3] - poses.map_from_node[:, :3, 3], axis=1)
    return AdjustedMap(
        Poses(poses.ids, placed, poses.covariances),
        len(adjusted.bundle.points),
        len(adjusted.bundle.point_of),
        float(np.sqrt(np.mean(change**2))),
    )
