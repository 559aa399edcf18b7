"""Pairs of images worth comparing: by words, in sequence, and by solved poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmyworld.config import Config
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.places.appearance import NEIGHBOURS, distinct, find_candidates
from mapmyworld.places.node_images import NodeImages
from mapmyworld.types import ConstraintKind, ImageMatch, Poses

_GAP = 5.0  # s that two nodes must lie apart to be the same place again
CANDIDATES = 3  # places verified for each image, at most
NEAR = 1.5  # m between nodes whose images are compared for being near
NEAR_ANGLE = 45.0  # deg between their headings, at most


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """Two images, `index` as a rule the later one."""

    index: int
    other: int
    """Rows of `NodeImages`: an image each."""
    kind: ConstraintKind
    source: ImageMatch
    """What proposes them; what registration indicates about them is still open."""
    guess: Array | None = None
    """(4, 4) other_from_index where tracking indicates it well enough to search around it only."""


def by_words(images: NodeImages, size: int, config: Config) -> list[Proposal]:
    """Pairs of images that have many rare words in common, over the whole log."""
    candidates = find_candidates(
        images.words(),
        size,
        images.stamps(),
        images.sessions(),
        gap_s=_GAP,
        least_similarity=config.visual.place_similarity,
        most=CANDIDATES,
    )
    closure = ConstraintKind.LOOP_CLOSURE
    return [Proposal(i, j, closure, ImageMatch(similarity=alike)) for i, j, alike in candidates]


def by_sequence(images: NodeImages) -> list[Proposal]:
    """Each node with the ones just before it, whose images measure the motion between them."""
    nodes, sessions, cameras = images.nodes, images.sessions(), images.camera_of
    found = []
    for i in range(1, len(sessions)):
        for j in range(max(0, i - NEIGHBOURS), i):
            if sessions[i] == sessions[j] and cameras[i] == cameras[j]:
                before, after = nodes[images.node_of[j]], nodes[images.node_of[i]]
                motion = between(before.tracked_from_base, after.tracked_from_base)
                steps = ImageMatch(steps=i - j)
                found.append(Proposal(i, j, ConstraintKind.PROXIMITY, steps, motion))
    return found


def by_poses(images: NodeImages, poses: Poses, already: Sequence[Proposal]) -> list[Proposal]:
    """Pairs that lie near each other and look the same way, the nearest of each pass first."""
    row_of = {int(i): k for k, i in enumerate(poses.ids)}
    rows = np.array([row_of.get(node.id, -1) for node in images.nodes])[images.node_of]
    placed = rows >= 0
    map_from_node = poses.map_from_node[np.maximum(rows, 0)]
    position = map_from_node[:, :3, 3]
    forward = _view_directions(images, map_from_node)
    stamps = images.stamps()
    tried = {(p.index, p.other) for p in already}
    found: list[Proposal] = []
    for i in np.flatnonzero(placed):
        distance = np.linalg.norm(position[:i] - position[i], axis=1)
        close = distance < NEAR
        close &= forward[:i] @ forward[i] > np.cos(np.radians(NEAR_ANGLE))
        close &= placed[:i] & (np.abs(stamps[i] - stamps[:i]) > _GAP * 1e9)
        order = np.flatnonzero(close)
        order = order[np.argsort(distance[order], kind="stable")]
        for j in distinct(order, CANDIDATES):
            if (int(i), j) not in tried:
                source = ImageMatch(distance=float(distance[j]))
                found.append(Proposal(int(i), j, ConstraintKind.PROXIMITY, source))
    return found


def _view_directions(images: NodeImages, map_from_node: Array) -> Array:
    """Unit vectors (N, 3) along which the images look, map frame.

    A camera is taken to be mounted as it is on the first node of each session.
    """
    axes: dict[tuple[int, int], Array] = {}
    keys = list(zip(images.sessions().tolist(), images.camera_of.tolist(), strict=True))
    for row, key in enumerate(keys):
        if key not in axes and (view := images.view(row)) is not None:
            axes[key] = view.camera.base_from_camera[:3, 2]
    every = np.stack([axes.get(key, np.array([1.0, 0, 0])) for key in keys])
    return np.asarray(np.einsum("nij,nj->ni", map_from_node[:, :3, :3], every))
