"""Loop closures by images: recognised over the whole log, verified by geometry, judged."""

from __future__ import annotations

import functools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.parallel import in_threads
from mapmyworld.places.appearance import NEIGHBOURS
from mapmyworld.places.drift import Drift
from mapmyworld.places.image_proposals import Proposal, by_poses, by_sequence, by_words
from mapmyworld.places.node_images import NodeImages
from mapmyworld.registration.image_pairs import ImagePair, register_images
from mapmyworld.registration.views import View
from mapmyworld.types import (
    CLOSURES,
    Constraint,
    ImageMatch,
    Judge,
    Judged,
    MapStore,
    Poses,
    Progress,
    Verdict,
    Why,
)

_Verified = tuple[Proposal, ImagePair]


def find_visual_closures(
    store: MapStore,
    poses: Poses | None,
    config: Config,
    progress: Progress,
    given_words: Mapping[int, NDArray[np.uint8]] | None = None,
) -> list[Judged]:
    """Every pair of nodes that was tried, as a constraint with its verdict.

    Loop closures are proposed by words; with solved `poses` also proximity constraints, between
    nodes that these bring together. Pairs that the store holds already are not tried again.
    Features, words and the vocabulary (learned, unless words are given: number -> descriptor (D,))
    are kept in the store, and words are asked once only.
    """
    images = NodeImages(store, config, progress)
    if len(images) < 3:
        return []
    first_look, known = not images.have_words, store.constraints()
    with_laser = store.node_data(images.nodes[0].id, features=False).scan is not None
    proposals: list[Proposal] = []
    if first_look:
        vocabulary = images.learn_words(given_words)
        proposals += by_words(images, vocabulary.size, config)
        if not with_laser:
            proposals += by_sequence(images)
    if poses is not None:
        proposals += by_poses(images, poses, proposals)
    tried = _pairs(known)
    ids = [images.nodes[n].id for n in images.node_of]
    fresh = [p for p in proposals if (ids[p.index], ids[p.other]) not in tried]
    if first_look:
        images.keep(store, vocabulary)
    verified = _verify(images, fresh, config, progress)
    return _judge(images, verified, Drift(images.nodes, known), config.odometry.contradiction)


def _verify(
    images: NodeImages, proposals: Sequence[Proposal], config: Config, progress: Progress
) -> list[_Verified]:
    progress.stage("closures by images", len(proposals), "pairs")
    view = functools.lru_cache(images.view)  # the store is read on the caller's thread only
    loaded = ((proposal, view(proposal.index), view(proposal.other)) for proposal in proposals)
    work = ((p, a, b) for p, a, b in loaded if a is not None and b is not None)

    def register(item: tuple[Proposal, View, View]) -> _Verified:
        proposal, later, earlier = item
        return proposal, register_images(earlier, later, config, guess=proposal.guess)

    done: list[_Verified] = []
    for verified in in_threads(register, work, config.threads):
        done.append(verified)
        progress.update(len(done))
    return done


def _judge(
    images: NodeImages, verified: Sequence[_Verified], drift: Drift, limit: float
) -> list[Judged]:
    """Constraints with their verdicts: geometry, drift of the tracked poses, ambiguity.

    `limit`: sigmas of drift by which a closure may contradict tracked poses. Images of successive
    nodes may, where wheels slip: they claim no place.
    """
    aliases: dict[int, float] = defaultdict(lambda: np.inf)
    verdicts: list[Verdict] = []
    for proposal, pair in verified:
        verdict = pair.registration.verdict
        i, j = _nodes_of(images, proposal)
        if proposal.guess is None and pair.fits and drift.comparable(i, j):
            own = pair.sigma_translation, pair.sigma_rotation
            motion = pair.registration.a_from_b
            sigma, metres, radians = drift.excess(j, i, motion, own)
            if sigma > limit:
                numbers = {
                    "metres": metres, "degrees": float(np.degrees(radians)), "sigmas": sigma
                }  # fmt: skip
                contradicts = Verdict(Judge.CAMERA, False, Why.MOTION_CONTRADICTS, numbers)
                verdict = contradicts if verdict.accepted else verdict
                for k in (i, j):
                    aliases[k] = min(aliases[k], metres)
        verdicts.append(verdict)
    constraints = []
    for (proposal, pair), verdict in zip(verified, verdicts, strict=True):
        i, j = _nodes_of(images, proposal)
        asked = verdict.accepted and proposal.guess is None
        doubt = _ambiguity((i, j), aliases, drift, limit) if asked else None
        ends = images.nodes[j].id, images.nodes[i].id
        constraints.append(_constraint(*ends, proposal, pair, doubt or verdict))
    return _best_of_pairs(constraints)


def _nodes_of(images: NodeImages, proposal: Proposal) -> tuple[int, int]:
    """Indices of the nodes of a pair of images."""
    return int(images.node_of[proposal.index]), int(images.node_of[proposal.other])


def _best_of_pairs(constraints: Sequence[Judged]) -> list[Judged]:
    """Of several cameras' measurements between two nodes the accepted one with most inliers."""
    best: dict[frozenset[int], Judged] = {}
    for c in constraints:
        pair = frozenset((c.from_id, c.to_id))
        if pair not in best or _worth(c) > _worth(best[pair]):
            best[pair] = c
    return list(best.values())


def _worth(constraint: Judged) -> tuple[bool, int]:
    assert isinstance(constraint.source, ImageMatch)
    return constraint.accepted, constraint.source.inliers


def _ambiguity(
    nodes: tuple[int, int], aliases: Mapping[int, float], drift: Drift, limit: float
) -> Verdict | None:
    """Why this closure could be one of several; None where the tracked motion decides.

    A node that also fits a place where it cannot be has a double at that distance. Where drift
    may be as large as that, a fit proves nothing.
    """
    i, j = nodes
    around = [k + s for k in (i, j) for s in range(-NEIGHBOURS, NEIGHBOURS + 1)]
    double = min((aliases[k] for k in around if k in aliases), default=np.inf)
    if not np.isfinite(double):
        return None
    possible = limit * drift.sigmas(i, j)[0] if drift.comparable(i, j) else np.inf
    if double > possible:
        return None
    numbers = {"metres": float(double), "drift": float(possible)}
    return Verdict(Judge.CAMERA, False, Why.AMBIGUOUS_VIEW, numbers)


def _constraint(
    from_id: int, to_id: int, proposal: Proposal, pair: ImagePair, verdict: Verdict
) -> Judged:
    registration = pair.registration
    source = replace(
        proposal.source,
        matches=len(pair.agreed),
        inliers=int(registration.inliers),
        share=float(registration.overlap),
    )
    if np.isfinite(registration.residual):
        source = replace(
            source,
            residual_px=float(registration.residual),
            sigma_m=float(pair.sigma_translation),
            sigma_rad=float(pair.sigma_rotation),
        )
    return Judged(
        from_id,
        to_id,
        proposal.kind,
        registration.a_from_b,
        registration.information,
        source,
        (verdict,),
    )


def _pairs(constraints: Sequence[Constraint]) -> set[tuple[int, int]]:
    """Pairs of ids, either way round, that were tried as closures before."""
    pairs = {
        (c.from_id, c.to_id)
        for c in constraints
        if c.kind in CLOSURES and isinstance(c.source, ImageMatch)
    }
    return pairs | {(b, a) for a, b in pairs}
