"""Made graphs as large as the published ones: city10000, kitti, ais2klinik, torus, garage, rim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from graph_worlds import Maker, drive, meetings, posed, sigmas, some, street_walk, turned

from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between, se3_exp
from mapmyworld.types.pose_graph import PoseGraph


def city(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """10,000 poses in a grid of streets, as many closures, 0.03 rad of noise a step."""
    truth = street_walk(10_000, rng)
    pairs = some(meetings(truth[:, :2], 1.1, 10), 10_000, rng)
    return truth, drive(truth, pairs, sigmas(True, 0.1, 0.03), rng)


def corridors(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Long corridors: 6,000 poses of a walk that turns every 60 m, 60 closures."""
    turns, truth = rng.choice([-1, 1], 100), np.zeros((6000, 3))
    heading = np.repeat(np.cumsum(turns), 60) * np.pi / 2
    truth[1:, 0] = np.cumsum(np.round(np.cos(heading[:-1])))
    truth[1:, 1] = np.cumsum(np.round(np.sin(heading[:-1])))
    truth[:, 2] = heading
    pairs = some(meetings(truth[:, :2], 1.1, 100), 60, rng)
    return truth, drive(truth, pairs, sigmas(True, 0.03, 0.01), rng)


def torus(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """5,000 poses around a torus, 0.2 rad of noise a step about every axis."""
    count, per = 5000, 100
    around, along = (2.0 * np.pi * np.arange(count) / n for n in (per, count))
    radius = 60.0 + 20.0 * np.cos(around)
    places = np.column_stack([radius * np.cos(along), radius * np.sin(along), 20 * np.sin(around)])
    truth = posed(places, turned(2, along) @ turned(1, around))
    pairs = np.column_stack([np.arange(count - per), np.arange(per, count)])
    return truth, drive(truth, pairs, sigmas(False, 0.1, 0.2), rng)


def garage(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """Eight floors driven up and down, 2,400 poses, a closure every ten between the ways."""
    per, floors = 150, 8
    up = np.arange(per * floors) * 2.0 * np.pi / per
    angle = np.concatenate([up, up[::-1]])
    way = np.column_stack([40.0 * np.cos(angle), 25.0 * np.sin(angle), angle + np.pi / 2])
    way[len(up) :, 2] += np.pi
    truth = planar_to_matrix(way)
    truth[:, 2, 3] = 3.0 * angle / (2.0 * np.pi)
    last = len(truth) - 1
    pairs = np.array([(k, last - k) for k in range(0, len(up) - 10, 10)])
    return truth, drive(truth, pairs, sigmas(False, 0.1, 0.1), rng)


def unequal(rng: np.random.Generator) -> tuple[np.ndarray, PoseGraph]:
    """3,000 poses in space whose edges are known a hundred times better or worse, correlated."""
    truth = planar_to_matrix(street_walk(3000, rng))
    truth[:, 2, 3] = 3.0 * np.sin(np.arange(3000) / 80.0)
    pairs = some(meetings(truth[:, :3, 3], 2.0, 10), 4000, rng)
    graph = drive(truth, pairs, sigmas(False, 0.05, 0.02), rng)
    return truth, correlated(truth, graph, 10.0, 0.3, rng)


def correlated(
    truth: np.ndarray, graph: PoseGraph, spread: float, mix: float, rng: np.random.Generator
) -> PoseGraph:
    """Axes known so many times better and worse, and mixed by a share of a random rotation."""
    edges, count = graph.edges, len(graph.edges)
    sigma = sigmas(False, 0.1, 0.03) * spread ** rng.uniform(-1.0, 1.0, (count, 6))
    turns = np.linalg.qr(rng.normal(size=(count, 6, 6)))[0]
    shape = ((1.0 - mix) * np.eye(6) + mix * turns) * sigma[:, None]
    noise = np.einsum("eij,ej->ei", shape, rng.normal(size=(count, 6)))
    motion = between(truth[edges.from_ids], truth[edges.to_ids]) @ se3_exp(noise)
    known = np.linalg.inv(shape @ np.swapaxes(shape, 1, 2))
    known = 0.5 * (known + np.swapaxes(known, 1, 2))
    return replace(graph, edges=replace(edges, i_from_j=motion, information=known))


LARGE: dict[str, Maker] = {
    "city, 10,000": city,
    "corridors": corridors,
    "torus, 5,000": torus,
    "garage, 8 floors": garage,
    "unequal": unequal,
}
