"""Graphs of the kinds that are published, beside plain gtsam.

python benchmarks/graph_kinds.py [M3500] [ring] [w10000] [rim] [correlated]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from common import DATA
from graph_gtsam import examples_cost
from graph_large import correlated, unequal
from graph_worlds import drive, meetings, posed, sigmas, some, street_walk, turned

from formats.graph_reading import read_graph
from mapmyworld.geometry.planar import wrap_angle
from mapmyworld.graph.optimisation import optimise
from mapmyworld.types.pose_graph import PoseGraph

Graphs = Iterator[tuple[str, PoseGraph]]


def m3500() -> Graphs:
    """Manhattan with more noise on every heading, its information less by as much."""
    graph = read_graph(DATA / "graphs" / "manhattan.g2o").graph
    blind, edges = np.zeros_like(graph.map_from_node), graph.edges
    for sigma in (0.1, 0.2, 0.3):
        rng, motion = np.random.default_rng(int(10 * sigma)), edges.i_from_j.copy()
        motion[:, 2] = wrap_angle(motion[:, 2] + sigma * rng.normal(size=len(motion)))
        known = np.diag([44.72, 44.72, 1.0 / (1.0 / 30.0 + sigma**2)])
        noisy = replace(edges, i_from_j=motion, information=np.tile(known, (len(motion), 1, 1)))
        yield f"{sigma} rad more", replace(graph, map_from_node=blind, edges=noisy)


def ring() -> Graphs:
    """Three rounds of a ring."""
    rng, angle = np.random.default_rng(6), np.arange(3000) * 6.0 * np.pi / 3000
    way = np.column_stack([100 * np.cos(angle), 100 * np.sin(angle), angle + np.pi / 2])
    pairs = some(meetings(way[:, :2], 2.0, 200), 1500, rng)
    for sigma in (0.01, 0.05, 0.1):
        yield f"{sigma} rad", drive(way, pairs, sigmas(True, 0.1, sigma), rng)


def w10000() -> Graphs:
    """Streets with many closures."""
    rng = np.random.default_rng(5)
    truth = street_walk(10_000, rng)
    pairs = some(meetings(truth[:, :2], 1.6, 5), 54_000, rng)
    yield f"{len(pairs)} closures", drive(truth, pairs, sigmas(True, 0.05, 0.02), rng)


def rim() -> Graphs:
    """Ten rounds in space."""
    rng, angle = np.random.default_rng(8), np.arange(6000) * 2.0 * np.pi / 600
    height = 0.5 * np.sin(7.3 * angle) + 0.01 * angle
    places = np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), height])
    pairs = some(meetings(places, 3.5, 100), 12_000, rng)
    truth = posed(places, turned(2, angle + np.pi / 2))
    yield "0.02 rad", drive(truth, pairs, sigmas(False, 0.05, 0.02), rng)


def spread_out() -> Graphs:
    for spread, mix in ((3, 0.3), (3, 0.45), (3, 0.6), (3, 1.0), (10, 0.45)):
        rng = np.random.default_rng(71)
        truth, graph = unequal(rng)
        yield f"{spread} times, {mix}", correlated(truth, graph, spread, mix, rng)


KINDS = {"M3500": m3500, "ring": ring, "w10000": w10000, "rim": rim, "correlated": spread_out}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("kinds", nargs="*", help=", ".join(KINDS))
    print(f"{'graph':<28}{'ours':>12}{'CPU s':>8}{'gtsam':>12}{'CPU s':>8}  certainty")
    for kind in parser.parse_args().kinds or list(KINDS):
        for name, graph in KINDS[kind]():
            started = time.process_time()
            solved = optimise(graph)
            between_them = time.process_time()
            plain = examples_cost(graph)
            seconds = between_them - started, time.process_time() - between_them
            print(
                f"{kind + ', ' + name:<28}{solved.cost:>12.6g}{seconds[0]:>8.1f}{plain:>12.6g}"
                f"{seconds[1]:>8.1f}  {solved.certainty}",
                flush=True,
            )


if __name__ == "__main__":
    main()
