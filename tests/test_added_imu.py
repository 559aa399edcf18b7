"""Preintegrated inertial samples between nodes, with velocities and biases, in the back end."""

from __future__ import annotations

import itertools
from pathlib import Path

import gtsam
import numpy as np

from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.backend.descent import solved
from mapmyworld.backend.factors import FactorGraph, factor_graph, poses_of
from mapmyworld.backend.information import Information
from mapmyworld.backend.residuals import retract
from mapmyworld.backend.system import System
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.types import Trajectory

EVERY = 6  # nodes from one that is seen to the next: 3 s, in which the drone flies 2 m
SIGMAS = np.array([0.002] * 3 + [0.03] * 3)  # rad and m of what is seen
BIASES = np.array([-0.013, 0.547, 0.068, -0.0022, 0.0208, 0.0763])  # m/s^2 and rad/s, from truth


def add_imu(graph: FactorGraph, at: Array, samples: Array, nodes: Array) -> None:
    """Samples (S, 6; rates, accelerations) `at` seconds, between nodes at these seconds."""
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    params.setGyroscopeCovariance(1e-5 * np.eye(3))  # ten times the data sheet's: rotors shake
    params.setAccelerometerCovariance(1e-3 * np.eye(3))
    params.setIntegrationCovariance(1e-6 * np.eye(3))
    params.setBiasAccCovariance(1e-5 * np.eye(3))
    params.setBiasOmegaCovariance(1e-9 * np.eye(3))
    v, b = (lambda k: gtsam.symbol("v", k)), (lambda k: gtsam.symbol("b", k))
    for k in range(len(nodes)):
        graph.values.insert(v(k), np.zeros(3))
        graph.values.insert(b(k), gtsam.imuBias.ConstantBias())
    vague = gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    graph.factors.add(gtsam.PriorFactorConstantBias(b(0), gtsam.imuBias.ConstantBias(), vague))
    for k, (start, end) in enumerate(itertools.pairwise(nodes)):
        summed = gtsam.PreintegratedCombinedMeasurements(params)
        for sample in samples[(at >= start) & (at < end)]:
            summed.integrateMeasurement(sample[3:], sample[:3], 0.005)
        keys = k, v(k), k + 1, v(k + 1), b(k), b(k + 1)
        graph.factors.add(gtsam.CombinedImuFactor(*keys, summed))


def test_imu_carries_a_drone_from_one_sighting_to_the_next(data: Path) -> None:
    truth = read_trajectory(data / "imu" / "euroc_v1_01.truth.tum")
    nodes = truth.stamps_ns[400:1000:10]  # every half second from 20 s on, in flight
    true, count = poses_at(truth, nodes), len(nodes)
    seen = np.append(np.arange(0, count - 1, EVERY), count - 1)
    noise = np.random.default_rng(1).normal(size=(len(seen), 6)) * SIGMAS
    sighted = retract(False, true[seen], noise)
    known = np.tile(np.diag(SIGMAS**-2.0), (len(seen), 1, 1))
    map_frame = np.full(len(seen), count)
    system = System(False, map_frame, seen, sighted, known, np.append(np.arange(count), -1))
    start = np.append(poses_at(Trajectory(nodes[seen], sighted), nodes), [np.eye(4)], axis=0)
    graph = factor_graph(system, start)
    recorded = open_log([data / "imu" / "euroc_v1_01.mcap"]).messages(["/imu0"])
    messages = [m.decode() for m in recorded]
    at = np.array([(m.stamp_ns - nodes[0]) * 1e-9 for m in messages])
    samples = np.array([[*m.angular_velocity, *m.linear_acceleration] for m in messages])
    add_imu(graph, at, samples, (nodes - nodes[0]) * 1e-9)
    found = solved(graph)
    missed = between(true, poses_of(system, found.values, start)[:count])
    metres, before = (np.linalg.norm(error[:, :3, 3], axis=1)
                      for error in (missed, between(true, start[:count])))  # fmt: skip
    assert np.sqrt(np.mean(before**2)) > 0.2  # by sightings alone
    assert np.sqrt(np.mean(metres**2)) < 0.06
    assert np.degrees(rotation_angle(missed)).mean() < 0.5
    last = gtsam.symbol("b", count - 1)
    off = found.values.atConstantBias(last).vector() - BIASES
    assert np.abs(off[:3]).max() < 0.1
    assert np.abs(off[3:]).max() < 0.005
    assert (np.sqrt(np.diag(Information.of(found).marginals(np.array([last]))[0])) < 0.1).all()
