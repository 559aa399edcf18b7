"""Loop closures by images: recognised over the whole log, verified by geometry, judged."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry import between
from mapmyworld.parallel import in_threads
from mapmyworld.places.appearance import Candidate, find_candidates
from mapmyworld.places.drift import Drift
from mapmyworld.places.node_images import NodeImages
from mapmyworld.registration.image_pairs import ImagePair, register_images
from mapmyworld.registration.views import View
from mapmyworld.types import (
    CLOSURES,
    Constraint,
    ConstraintKind,
    MapStore,
    Node,
    Poses,
    Progress,
)

Array = NDArray[np.float64]
_NEAR_NODES = 3  # nodes to either side that share the ambiguity of one


def find_visual_closures(
    store: MapStore,
    poses: Poses | None,
    config: Config,
    progress: Progress,
    given_words: Mapping[int, NDArray[np.uint8]] | None = None,
) -> list[Constraint]:
    """Every pair of nodes that was tried, as a constraint with verdict, reason and evidence.

    Loop closures are proposed by words; with solved `poses` also proximity constraints, between
    nodes that these bring together. Pairs that the store holds already are not tried again.
    Features, words and the vocabulary (learned, unless words are given: number -> descriptor) are
    kept in the store, and words are asked once only.
    """
    images = NodeImages(store, config, progress)
    if len(images) < 3:
        return []
    proposals: list[_Proposal] = []
    if not images.have_words:
        vocabulary = images.learn_words(given_words)
        images.keep(store, vocabulary)
        proposals += _by_words(images, vocabulary.size, config)
        if config.visual.succession and store.node_data(images.nodes[0].id).scan is None:
            proposals += _by_succession(images, config)
    if poses is not None:
        proposals += _by_poses(images, poses, proposals, config)
    known = _pairs(store.constraints())
    ids = [node.id for node in images.nodes]
    fresh = [p for p in proposals if (ids[p.index], ids[p.other]) not in known]
    return _judge(images.nodes, _verify(images, fresh, config, progress), config)


@dataclass(frozen=True, slots=True, eq=False)
class _Proposal:
    index: int
    other: int
    kind: ConstraintKind
    evidence: Mapping[str, float]
    guess: Array | None = None
    """other_from_index where tracking tells it well enough to search around it only."""


@dataclass(frozen=True, slots=True, eq=False)
class _Verified:
    proposal: _Proposal
    pair: ImagePair


def _by_words(images: NodeImages, size: int, config: Config) -> list[_Proposal]:
    settings = config.visual
    candidates = find_candidates(
        images.words(),
        size,
        np.array([node.stamp_ns for node in images.nodes]),
        np.array([node.session for node in images.nodes]),
        gap_s=settings.place_gap,
        least_similarity=settings.place_similarity,
        least_posterior=settings.place_posterior,
        most=settings.place_candidates,
    )
    return [_proposal_of(candidate) for candidate in candidates]


def _proposal_of(candidate: Candidate) -> _Proposal:
    evidence = {"similarity": candidate.similarity, "posterior": candidate.posterior}
    return _Proposal(candidate.index, candidate.other, ConstraintKind.LOOP_CLOSURE, evidence)


def _by_succession(images: NodeImages, config: Config) -> list[_Proposal]:
    """Each node with the ones just before it: what the images say of the motion between them."""
    nodes = images.nodes
    found = []
    for i in range(1, len(nodes)):
        for j in range(max(0, i - config.visual.succession), i):
            if nodes[i].session == nodes[j].session:
                motion = between(nodes[j].tracked_from_base, nodes[i].tracked_from_base)
                steps = {"steps": float(i - j)}
                found.append(_Proposal(i, j, ConstraintKind.PROXIMITY, steps, motion))
    return found


def _by_poses(
    images: NodeImages, poses: Poses, already: Sequence[_Proposal], config: Config
) -> list[_Proposal]:
    """Pairs that lie near each other and look the same way, the nearest of each pass first."""
    settings = config.visual
    row_of = {int(i): k for k, i in enumerate(poses.ids)}
    rows = [row_of.get(node.id, -1) for node in images.nodes]
    placed = np.array(rows) >= 0
    map_from_node = poses.map_from_node[np.maximum(rows, 0)]
    position = map_from_node[:, :3, 3]
    forward = _view_directions(images, map_from_node)
    stamps = np.array([node.stamp_ns for node in images.nodes])
    tried = {(p.index, p.other) for p in already}
    found: list[_Proposal] = []
    for i in np.flatnonzero(placed):
        distance = np.linalg.norm(position[:i] - position[i], axis=1)
        close = distance < settings.proximity_distance
        close &= forward[:i] @ forward[i] > np.cos(np.radians(settings.proximity_angle))
        close &= placed[:i] & (stamps[i] - stamps[:i] > settings.place_gap * 1e9)
        order = np.flatnonzero(close)
        order = order[np.argsort(distance[order], kind="stable")]
        for j in _spaced(order, settings.proximity_candidates):
            if (int(i), j) not in tried:
                evidence = {"distance": float(distance[j])}
                found.append(_Proposal(int(i), j, ConstraintKind.PROXIMITY, evidence))
    return found


def _view_directions(images: NodeImages, map_from_node: Array) -> Array:
    """Unit vectors (N, 3) along which the nodes' cameras look, map frame.

    The camera is taken to be mounted as it is on the first node of each session.
    """
    axes: dict[int, Array] = {}
    for k, node in enumerate(images.nodes):
        if node.session not in axes and (view := images.view(k)) is not None:
            axes[node.session] = view.camera.base_from_camera[:3, 2]
    every = np.stack([axes.get(node.session, np.array([1.0, 0, 0])) for node in images.nodes])
    return np.asarray(np.einsum("nij,nj->ni", map_from_node[:, :3, :3], every))


def _spaced(order: NDArray[np.int64], most: int) -> list[int]:
    """The first few indices of `order` that are no neighbours of each other."""
    chosen: list[int] = []
    for j in order:
        if len(chosen) < most and all(abs(int(j) - other) > 2 for other in chosen):
            chosen.append(int(j))
    return chosen


def _verify(
    images: NodeImages, proposals: Sequence[_Proposal], config: Config, progress: Progress
) -> list[_Verified]:
    progress.stage("closures by images", len(proposals), "pairs")
    work = _loaded(images, proposals)

    def register(item: tuple[_Proposal, View, View]) -> _Verified:
        proposal, later, earlier = item
        return _Verified(proposal, register_images(earlier, later, config, guess=proposal.guess))

    done: list[_Verified] = []
    for verified in in_threads(register, work, config.threads):
        done.append(_by_scans(images, verified, config))
        progress.update(len(done))
    return done


def _by_scans(images: NodeImages, item: _Verified, config: Config) -> _Verified:
    """The pair aligned by the laser scans of both nodes, where wanted and there."""
    if not (config.visual.closure_scans and item.pair.registration.converged):
        return item
    earlier, later = images.scan(item.proposal.other), images.scan(item.proposal.index)
    if earlier is None or later is None:
        return item
    from mapmyworld.places.scan_check import refine_by_scans

    return replace(item, pair=refine_by_scans(item.pair, earlier, later, config))


def _loaded(
    images: NodeImages, proposals: Sequence[_Proposal]
) -> Iterator[tuple[_Proposal, View, View]]:
    """Proposals with both views; the store is read on the caller's thread only."""
    for proposal in proposals:
        later, earlier = images.view(proposal.index), images.view(proposal.other)
        if later is not None and earlier is not None:
            yield proposal, later, earlier


def _judge(
    nodes: Sequence[Node], verified: Sequence[_Verified], config: Config
) -> list[Constraint]:
    """Constraints with their verdicts: geometry, drift of the tracked poses, ambiguity."""
    drift = Drift(nodes, config)
    gate = config.visual.closure_gate
    aliases: dict[int, float] = defaultdict(lambda: np.inf)
    reasons: list[str] = []
    for item in verified:
        reason = "" if item.pair.registration.converged else item.pair.registration.reason
        i, j = item.proposal.index, item.proposal.other
        if item.pair.fits and drift.comparable(i, j):
            own = item.pair.sigma_translation, item.pair.sigma_rotation
            motion = item.pair.registration.a_from_b
            sigma, metres, radians = drift.excess(j, i, motion, own)
            if sigma > gate:
                reason = reason or (
                    f"looks alike, but contradicts the tracked motion by {metres:.2f} m and "
                    f"{np.degrees(radians):.0f} deg, {sigma:.1f} sigma"
                )
                for k in (i, j) if item.proposal.guess is None else ():
                    aliases[k] = min(aliases[k], metres)
        reasons.append(reason)
    constraints = []
    for item, given in zip(verified, reasons, strict=True):
        guided = item.proposal.guess is not None
        reason = given if guided else given or _ambiguity(item, aliases, drift, gate)
        constraints.append(_constraint(nodes, item, reason))
    return constraints


def _ambiguity(item: _Verified, aliases: Mapping[int, float], drift: Drift, gate: float) -> str:
    """Why this closure could be one of several; empty where the tracked motion decides.

    A node that also fits a place where it cannot be has a double at that distance. Where drift
    may be as large as that, a fit proves nothing.
    """
    i, j = item.proposal.index, item.proposal.other
    around = [k + s for k in (i, j) for s in range(-_NEAR_NODES, _NEAR_NODES + 1)]
    double = min((aliases[k] for k in around if k in aliases), default=np.inf)
    if not np.isfinite(double):
        return ""
    possible = gate * drift.sigmas(i, j)[0] if drift.comparable(i, j) else np.inf
    if double > possible:
        return ""
    return (
        f"ambiguous: the same view fits {double:.1f} m away, and drift may reach {possible:.1f} m"
    )


def _constraint(nodes: Sequence[Node], item: _Verified, reason: str) -> Constraint:
    registration = item.pair.registration
    evidence = {
        **item.proposal.evidence,
        "matches": float(len(item.pair.agreed)),
        "inliers": float(registration.inliers),
        "share": registration.overlap,
        "cells": float(item.pair.cells),
    }
    if np.isfinite(registration.residual):
        evidence["residual_px"] = registration.residual
        evidence["sigma_m"] = item.pair.sigma_translation
        evidence["sigma_rad"] = item.pair.sigma_rotation
    return Constraint(
        nodes[item.proposal.other].id,
        nodes[item.proposal.index].id,
        item.proposal.kind,
        registration.a_from_b,
        registration.information,
        reason == "",
        reason or registration.reason,
        evidence,
    )


def _pairs(constraints: Sequence[Constraint]) -> set[tuple[int, int]]:
    """Pairs of ids, either way round, that were tried as closures before."""
    pairs = {
        (c.from_id, c.to_id) for c in constraints if c.kind in CLOSURES and "matches" in c.evidence
    }
    return pairs | {(b, a) for a, b in pairs}
