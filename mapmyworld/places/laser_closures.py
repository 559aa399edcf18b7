"""Loop closures by scans alone: submap against submap, searched as far as the drift may reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.planar import between_planar, information_from_planar, planar_to_matrix
from mapmyworld.kernels.laser_motion import leaves_open
from mapmyworld.odometry.laser_stretches import leaves_turn_open
from mapmyworld.parallel import in_threads
from mapmyworld.places.laser_candidates import (
    FIRST_WINDOW,
    candidate_pairs,
    drift_window,
    untied,
)
from mapmyworld.places.laser_joins import doubt_joins
from mapmyworld.places.laser_lookalikes import doubt_lookalikes
from mapmyworld.places.laser_lost import held_by, islands, lost_pairs
from mapmyworld.places.laser_nodes import LaserNodes, NodeScans, nodes_at
from mapmyworld.places.laser_submaps import match_submaps, submap_around, submap_members
from mapmyworld.registration.scan_matching import (
    Match,
)
from mapmyworld.registration.scan_search import (
    Found,
    LikelihoodGrid,
    likelihood_grid,
    search_grid,
)
from mapmyworld.types import Constraint, ConstraintKind, MapStore, Poses, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SETTLED_WINDOW = 1.0  # m to each side that is searched once the graph is optimised
_SETTLED_ANGLE = 0.2  # rad, the same
_AHEAD = 8  # places a thread that are made ready: one may take as long as many others
_AGREEMENT = np.diag([0.02**2, 0.02**2, 0.005**2])  # m^2 and rad^2 that two maps may differ by


def first_closures(
    loaded: NodeScans,
    poses: Poses | None,
    known: Sequence[Constraint],
    span: tuple[int, int],
    config: Config,
    progress: Progress,
) -> list[Constraint]:
    """Pairs of places compared from poses that have drifted, the later one in this span of nodes.

    The search reaches as far as the drift may have gone, up to 15 m: since the earlier visit, or
    since the robot was last where one of the `known` closures holds the solved `poses`. Without
    these, tracked poses are taken.
    """
    nodes = nodes_at(loaded, poses, span[1])
    if poses is not None:
        nodes = held_by(nodes, known)
    pairs = candidate_pairs(nodes, config, settled=False, first=span[0])
    progress.stage("loop closures by laser", len(pairs), "pairs")
    return compare_places(nodes, pairs, config, settled=False)


def find_laser_closures(
    store: MapStore,
    poses: Poses,
    config: Config,
    progress: Progress,
    loaded: NodeScans,
    tied: Sequence[Constraint] = (),
    since: int = 0,
) -> list[Constraint]:
    """Every pair of places that was compared from optimised poses, with its verdict.

    The search reaches only a little, where the kind is `proximity`; and as far as the settings let
    it where nothing was recognised for long. Places that `tied` closures join are not compared
    again, nor are nodes with ids before `since` with each other.
    """
    if len(loaded.nodes) < 2:
        return []
    nodes = nodes_at(loaded, poses)
    known = {(c.from_id, c.to_id) for c in store.constraints()}

    def untried(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
        ends = [(a, b, int(nodes.ids[a]), int(nodes.ids[b])) for a, b in pairs]
        return [(a, b) for a, b, i, j in ends if (i, j) not in known and j >= since]

    island = islands(loaded, tied)
    pairs = [(a, b) for a, b in candidate_pairs(nodes, config, settled=True)
             if island[a] == island[b]]  # fmt: skip
    pairs = untried(untied(nodes, pairs, tied))
    nodes = replace(nodes, part=held_by(nodes, tied).part)
    lost = untried(lost_pairs(nodes, tied, config))
    lost = [pair for pair in lost if pair not in set(pairs)]
    progress.stage("loop closures by laser", len(pairs) + len(lost), "pairs")
    near = compare_places(nodes, pairs, config, settled=True)
    widest = config.places.laser_window
    return near + compare_places(nodes, lost, config, settled=False, widest=widest)


def compare_places(
    nodes: LaserNodes,
    pairs: list[tuple[int, int]],
    config: Config,
    *,
    settled: bool,
    widest: float = FIRST_WINDOW,
) -> list[Constraint]:
    """Each pair's constraint, accepted or not, in the order of the pairs.

    From settled poses the search is small, else as far as drift goes, `widest` metres at most.
    """
    by_target: dict[int, list[int]] = {}
    for k, (a, _) in enumerate(pairs):
        by_target.setdefault(a, []).append(k)

    def compare(target: tuple[LaserNodes, int, list[int]]) -> list[Constraint]:
        held, a, rows = target
        grid = likelihood_grid(submap_around(held, a, config))  # large: one a thread is held
        return [_compare(held, grid, *pairs[k], config, settled, widest) for k in rows]

    def targets() -> Iterator[tuple[LaserNodes, int, list[int]]]:
        for a, rows in by_target.items():
            ends = [
                submap_members(nodes, node, config) for node in (a, *(pairs[k][1] for k in rows))
            ]
            yield replace(nodes, scans=nodes.scans.hold(np.concatenate(ends))), a, rows

    found = in_threads(compare, targets(), config.threads, _AHEAD)
    places = [k for rows in by_target.values() for k in rows]
    by_place = dict(zip(places, (c for some in found for c in some), strict=True))
    closures = [by_place[k] for k in range(len(pairs))]
    if settled:
        return closures
    closures = doubt_lookalikes(nodes, pairs, closures, config, widest)
    return doubt_joins(nodes, pairs, closures, config, widest)


def _compare(
    nodes: LaserNodes,
    grid: LikelihoodGrid,
    a: int,
    b: int,
    config: Config,
    settled: bool,
    widest: float,
) -> Constraint:
    places = config.places
    guess = between_planar(nodes.poses[a], nodes.poses[b])
    distance, angle = _SETTLED_WINDOW, _SETTLED_ANGLE
    if not settled:
        distance, angle = drift_window(nodes, a, b, config, widest)
    points = submap_around(nodes, b, config)
    found = search_grid(points, grid, guess, distance, angle, places.laser_score)
    if found is None:
        return _rejected(nodes, a, b, settled, guess, f"score below {places.laser_score}", {})
    match = match_submaps(nodes, a, b, found.pose, config)
    return _verdict(nodes, a, b, guess, found, match, config, settled)


def _verdict(
    nodes: LaserNodes, a: int, b: int, guess: Array, found: Found, match: Match,
    config: Config, settled: bool,
) -> Constraint:  # fmt: skip
    places = config.places
    moved = between_planar(guess, match.pose)
    slipped = between_planar(found.pose, match.pose)
    evidence = {
        "score": found.score,
        "rival": found.rival,
        "overlap": match.overlap,
        "residual": match.residual,
        "moved": float(np.hypot(*moved[:2])),
    }
    if match.overlap < places.laser_overlap:
        reason = f"overlap {match.overlap:.0%} below {places.laser_overlap:.0%}"
    elif found.rival > places.laser_rival * found.score:
        reason = f"ambiguous: another pose scores {found.rival:.2f} against {found.score:.2f}"
    elif np.hypot(*slipped[:2]) > 0.5 or abs(slipped[2]) > 0.15:
        reason = "not converged: the refined pose left the best one of the search"
    elif leaves_open(match.information) or leaves_turn_open(match.information):
        reason = "poorly constrained: the surfaces leave a direction open"
    else:
        return _constraint(nodes, a, b, settled, match, evidence)
    return _rejected(nodes, a, b, settled, match.pose, reason, evidence)


def _kind(settled: bool) -> ConstraintKind:
    return ConstraintKind.PROXIMITY if settled else ConstraintKind.LOOP_CLOSURE


def _constraint(
    nodes: LaserNodes, a: int, b: int, settled: bool, match: Match, evidence: dict[str, float]
) -> Constraint:
    return Constraint(
        from_id=int(nodes.ids[a]),
        to_id=int(nodes.ids[b]),
        kind=_kind(settled),
        from_from_to=planar_to_matrix(match.pose),
        information=information_from_planar(closure_information(match)),
        reason=f"overlap {match.overlap:.0%}, residual {match.residual:.3f} m",
        evidence=evidence,
    )


def closure_information(match: Match) -> Array:
    """(3, 3): nothing is known better than the maps of the two places agree in themselves."""
    return np.asarray(np.linalg.inv(np.linalg.inv(match.information) + _AGREEMENT))


def _rejected(
    nodes: LaserNodes, a: int, b: int, settled: bool, pose: Array, reason: str,
    evidence: dict[str, float],
) -> Constraint:  # fmt: skip
    return Constraint(
        from_id=int(nodes.ids[a]),
        to_id=int(nodes.ids[b]),
        kind=_kind(settled),
        from_from_to=planar_to_matrix(pose),
        information=information_from_planar(np.eye(3)),
        accepted=False,
        reason=reason,
        evidence=evidence,
    )
