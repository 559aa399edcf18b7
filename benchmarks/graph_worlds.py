"""Simulated pose graphs: a drive with its truth, noisy odometry and closures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from mapmyworld.backend.residuals import retract
from mapmyworld.geometry.planar import between_planar, compose_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.geometry.rotations import so3_exp
from mapmyworld.types.pose_graph import Edges, PoseGraph, no_priors, no_sightings


def drive(
    truth: np.ndarray, pairs: np.ndarray, sigma: np.ndarray, rng: np.random.Generator
) -> PoseGraph:
    """The graph of a drive along `truth` (N, 3) or (N, 4, 4) with closures between `pairs`."""
    planar, count = truth.ndim == 2, len(truth)
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    ends = np.concatenate([chain, pairs])
    motion = (between_planar if planar else between)(truth[ends[:, 0]], truth[ends[:, 1]])
    measured = retract(planar, motion, rng.normal(size=(len(ends), len(sigma))) * sigma)
    origin = np.zeros(3) if planar else np.eye(4)
    return PoseGraph(
        planar,
        np.arange(count),
        np.tile(origin, (count, *[1] * origin.ndim)),
        Edges(
            ends[:, 0],
            ends[:, 1],
            measured,
            np.tile(np.diag(sigma**-2.0), (len(ends), 1, 1)),
            np.arange(len(ends)) < count - 1,
        ),
        landmarks=np.zeros((0, 2 if planar else 3)),
        sightings=no_sightings(planar),
        priors=no_priors(planar),
    )


def world(kind: str, count: int, seed: int = 0) -> PoseGraph:
    """A simulated drive, with closures to half as many earlier nodes nearby.

    "manhattan": a walk along the streets of a grid, 1 m a step; "spiral": ever wider rounds, each
    node seeing the round before.
    """
    rng = np.random.default_rng(seed)
    truth = street_walk(count, rng) if kind == "manhattan" else _spiral(count)
    pairs = cKDTree(truth[:, :2]).query_pairs(1.5, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > 10]
    pairs = pairs[rng.permutation(len(pairs))[: count // 2]]
    return drive(truth, pairs, np.array([0.05, 0.05, 0.01]), rng)


def street_walk(count: int, rng: np.random.Generator) -> np.ndarray:
    side = int(np.sqrt(count) * 0.6)
    turns = rng.choice([-1, 0, 1], count)
    poses, x, y, heading = np.zeros((count, 3)), 0, 0, 0
    steps = ((1, 0), (0, 1), (-1, 0), (0, -1))
    for k in range(count):
        poses[k] = x, y, heading * np.pi / 2
        if k % 4 == 3:
            heading = (heading + int(turns[k])) % 4
        while not (0 <= x + steps[heading][0] <= side and 0 <= y + steps[heading][1] <= side):
            heading = (heading + 1) % 4
        x, y = x + steps[heading][0], y + steps[heading][1]
    return poses


def _spiral(count: int) -> np.ndarray:
    length = np.arange(count, dtype=np.float64)
    angle = np.sqrt(4.0 * np.pi * length) + 1e-9
    radius = angle / (2.0 * np.pi)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])


def sigmas(planar: bool, metres: float, radians: float) -> np.ndarray:
    return np.array([metres] * 2 + [radians] if planar else [radians] * 3 + [metres] * 3)


def meetings(places: np.ndarray, reach: float, apart: int) -> np.ndarray:
    """Pairs of nodes within `reach` metres of each other, `apart` steps apart, ascending."""
    pairs = np.sort(cKDTree(places).query_pairs(reach, output_type="ndarray"), axis=1)
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > apart]
    return pairs[np.lexsort(pairs.T[::-1])]


def some(pairs: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return pairs[rng.permutation(len(pairs))[:count]]


def posed(places: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, 3], poses[:, :3, :3] = places, rotations
    return poses


def turned(axis: int, angle: np.ndarray) -> np.ndarray:
    vectors = np.zeros((len(angle), 3))
    vectors[:, axis] = angle
    return so3_exp(vectors)


def ring(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """300 poses, noisy turns, two closures at its end."""
    truth, pairs = _circle(300, 300), np.array([(0, 299), (1, 298)])
    return truth, drive(truth, pairs, sigmas(True, 0.1, 0.1), rng)


def streets(rng: np.random.Generator, turns: float = 0.2) -> tuple[np.ndarray, PoseGraph]:
    """1,500 poses in a grid of streets, 0.2 rad of noise a step."""
    truth = street_walk(1500, rng)
    pairs = some(meetings(truth[:, :2], 1.5, 10), 700, rng)
    return truth, drive(truth, pairs, sigmas(True, 0.05, turns), rng)


def few_closures(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """As MIT's corridors: 800 poses, bad odometry, 20 closures."""
    truth = street_walk(800, rng)
    pairs = some(meetings(truth[:, :2], 1.5, 10), 20, rng)
    return truth, drive(truth, pairs, sigmas(True, 0.1, 0.12), rng)


def grid(rng: np.random.Generator, turns: float = 0.1) -> tuple[np.ndarray, PoseGraph]:
    """A way through all of a cube's 216 points, closures between neighbouring ones."""
    side, places = 6, []
    for z in range(side):
        for y in range(side)[:: 1 if z % 2 == 0 else -1]:
            places += [(x, y, z) for x in range(side)[:: 1 if (y + z) % 2 == 0 else -1]]
    truth = posed(np.array(places, np.float64), so3_exp(rng.normal(size=(len(places), 3))))
    pairs = meetings(truth[:, :3, 3], 1.01, 1)
    return truth, drive(truth, pairs, sigmas(False, 0.1, turns), rng)


def torus(rng: np.random.Generator, turns: float = 0.05) -> tuple[np.ndarray, PoseGraph]:
    """800 poses around a torus, every round sees the one before."""
    count, per = 800, 50
    around, along = (2.0 * np.pi * np.arange(count) / n for n in (per, count))
    radius = per / 6.0 + per / 18.0 * np.cos(around)
    places = np.column_stack(
        [radius * np.cos(along), radius * np.sin(along), per / 18.0 * np.sin(around)]
    )
    truth = posed(places, turned(2, along) @ turned(1, around))
    pairs = np.column_stack([np.arange(count - per), np.arange(per, count)])
    return truth, drive(truth, pairs, sigmas(False, turns, turns), rng)


def sphere(rng: np.random.Generator, turns: float = 0.1) -> tuple[np.ndarray, PoseGraph]:
    """800 poses around a sphere, every round sees the one before."""
    count, per = 800, 40
    height = np.pi * (np.arange(count) + 0.5) / count - np.pi / 2.0
    around = 2.0 * np.pi * np.arange(count) / per
    places = 50.0 * np.column_stack(
        [np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)]
    )
    truth = posed(places, turned(2, around) @ turned(1, height))
    pairs = np.column_stack([np.arange(count - per), np.arange(per, count)])
    return truth, drive(truth, pairs, sigmas(False, 2.0 * turns, turns), rng)


def cubicle(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """1,000 poses in space along streets, tilting, with three closures a node."""
    truth = planar_to_matrix(street_walk(1000, rng))
    truth[:, 2, 3] = 2.0 * np.sin(np.arange(1000) / 60.0)
    tilt = np.zeros((1000, 6))
    tilt[:, :3] = 0.1 * rng.normal(size=(1000, 3))
    truth = truth @ se3_exp(tilt)
    pairs = some(meetings(truth[:, :3, 3], 2.0, 10), 3000, rng)
    return truth, drive(truth, pairs, sigmas(False, 0.05, 0.02), rng)


def garage(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Five floors of a ramp, 750 poses, a closure to the floor below every 20, noisy turns."""
    angle = np.arange(750) * 2.0 * np.pi / 150
    truth = planar_to_matrix(
        np.column_stack([30.0 * np.cos(angle), 18.0 * np.sin(angle), angle + np.pi / 2])
    )
    truth[:, 2, 3] = 3.0 * angle / (2.0 * np.pi)
    pairs = np.array([(k, k + 150) for k in range(0, 600, 20)])
    return truth, drive(truth, pairs, sigmas(False, 0.05, 0.15), rng)


def _circle(count: int, per: int) -> np.ndarray:
    """Planar poses around a circle of `per` metres, a metre a step."""
    angle = np.arange(count) * 2.0 * np.pi / per
    radius = per / (2.0 * np.pi)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])


def long_ring(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """600 poses, 0.2 rad of noise a step, three closures at its end."""
    pairs = np.array([(0, 599), (1, 598), (2, 597)])
    return _circle(600, 600), drive(_circle(600, 600), pairs, sigmas(True, 0.1, 0.2), rng)


def laps(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Three rounds of 200 poses, 0.2 rad of noise a step, a closure to the last round every 20."""
    truth = _circle(600, 200)
    pairs = np.array([(k, k + 200) for k in range(0, 400, 20)])
    return truth, drive(truth, pairs, sigmas(True, 0.1, 0.2), rng)


def rings(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Four rings of 150 poses that touch, as a clover; one closure where each begins and ends."""
    truth, pairs = [], []
    for k in range(4):
        ring = _circle(151, 150) - [150 / (2.0 * np.pi), 0.0, 0.0]
        turn = np.array([0.0, 0.0, k * np.pi / 2])
        truth.append(compose_planar(turn, ring))
        pairs += [(151 * k, 151 * k + 150), (0, 151 * k + 150)]
    poses = np.concatenate(truth)
    return poses, drive(poses, np.array(pairs), sigmas(True, 0.1, 0.2), rng)


def ladder(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Up one lane and down the other, 250 metres, a rung every 25; 0.2 rad of noise a step."""
    up = np.column_stack([np.arange(250.0), np.zeros(250), np.zeros(250)])
    down = np.column_stack([np.arange(249.0, -1.0, -1.0), np.full(250, 5.0), np.full(250, np.pi)])
    pairs = np.array([(k, 499 - k) for k in range(0, 250, 25)])
    truth = np.concatenate([up, down])
    return truth, drive(truth, pairs, sigmas(True, 0.1, 0.2), rng)


def ring_in_space(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """A ring of 400 poses that rises and falls, 0.15 rad of noise a step about every axis."""
    truth = planar_to_matrix(_circle(400, 400))
    truth[:, 2, 3] = 3.0 * np.sin(np.arange(400) * 2.0 * np.pi / 100)
    pairs = np.array([(0, 399), (1, 398), (2, 397)])
    return truth, drive(truth, pairs, sigmas(False, 0.1, 0.15), rng)


Maker = Callable[[np.random.Generator], tuple[np.ndarray, PoseGraph]]
KINDS: dict[str, Maker] = {
    "ring": ring,
    "streets": streets,
    "few closures": few_closures,
    "grid3D": grid,
    "grid3D, 0.3 rad": lambda rng: grid(rng, 0.3),
    "torus3D": torus,
    "torus3D, 0.3 rad": lambda rng: torus(rng, 0.3),
    "sphere": sphere,
    "sphere, 0.3 rad": lambda rng: sphere(rng, 0.3),
    "cubicle": cubicle,
    "garage, 0.15 rad": garage,
}

# Where odometry and LAGO lead to minima that cost a multiple of the best.
HARD: dict[str, Maker] = {
    "long ring": long_ring,
    "laps": laps,
    "clover": rings,
    "ladder": ladder,
    "ring in space": ring_in_space,
    "few closures": few_closures,
    "streets": streets,
    "garage, 0.15 rad": garage,
    "sphere, 0.3 rad": lambda rng: sphere(rng, 0.3),
    "grid3D, 0.3 rad": lambda rng: grid(rng, 0.3),
    "torus3D, 0.3 rad": lambda rng: torus(rng, 0.3),
}
