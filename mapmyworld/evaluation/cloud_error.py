"""How far a cloud lies from the true surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.errors import MapError
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.geometry import Array
from mapmyworld.types import Mesh, PointCloud

_NEIGHBOURS = 48  # triangles with the nearest sample, of which the exact distance is taken
_CHUNK = 20_000  # points at a time, to bound memory
_MOST_SAMPLES = 400_000


def cloud_distances(cloud: PointCloud, mesh: Mesh) -> Array:
    """(N,) metres from each point to the nearest triangle of the mesh.

    Candidates come from samples spread over the triangles; the distance to each is exact.
    """
    from trimesh.triangles import closest_point  # a second of a start, which few commands need

    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    samples, owners = _samples(corners)
    tree = cKDTree(samples)
    found = np.empty(len(cloud.points))
    count = min(_NEIGHBOURS, len(samples))
    for start in range(0, len(cloud.points), _CHUNK):
        points = cloud.points[start : start + _CHUNK].astype(np.float64)
        near = tree.query(points, k=count)[1].reshape(len(points), -1)
        best = np.full(len(points), np.inf)
        for column in range(near.shape[1]):
            nearest = closest_point(corners[owners[near[:, column]]], points)
            best = np.minimum(best, np.linalg.norm(points - nearest, axis=1))
        found[start : start + len(points)] = best
    return found


def cloud_score(cloud: PointCloud, mesh: Mesh) -> ErrorStatistics:
    """Statistics of the distances, metres; raises `MapError` for a cloud without points."""
    if len(cloud.points) == 0:
        raise MapError("a cloud without points has no distance from anything: give another")
    return summarise(cloud_distances(cloud, mesh))


def _samples(corners: Array) -> tuple[Array, NDArray[np.int64]]:
    """Points on the triangles, denser than the error they could make, and their owners."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    spacing = max(0.05, float(np.sqrt(area.sum() / _MOST_SAMPLES)))
    counts = np.clip(np.ceil(edges / spacing), 1, 400).astype(np.int64)
    points, owners = [], []
    for index, count in enumerate(counts):
        u, v = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1))
        inside = u + v <= 1.0 + 1e-9
        a, b, c = corners[index]
        points.append(a + u[inside, None] * (b - a) + v[inside, None] * (c - a))
        owners.append(np.full(int(inside.sum()), index, np.int64))
    return np.concatenate(points), np.concatenate(owners)
