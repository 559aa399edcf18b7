"""How far a cloud lies from the true surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapmyworld.errors import MapError
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.types import Mesh, PointCloud

_NEIGHBOURS = 48  # triangles with the nearest sample, of which the exact distance is taken
_CHUNK = 20_000  # points at a time, to bound memory
_MOST_SAMPLES = 400_000


def cloud_distances(cloud: PointCloud, mesh: Mesh) -> NDArray[np.float64]:
    """(N,) metres from each point to the nearest triangle of the mesh.

    Candidates come from samples spread over the triangles; the distance to each is exact.
    """
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
            triangle = corners[owners[near[:, column]]]
            best = np.minimum(best, point_triangle_distance(points, triangle))
        found[start : start + len(points)] = best
    return found


def cloud_score(cloud: PointCloud, mesh: Mesh) -> ErrorStatistics:
    """Statistics of the distances, metres; raises `MapError` for a cloud without points."""
    if len(cloud.points) == 0:
        raise MapError("a cloud without points has no distance from anything: give another")
    return summarise(cloud_distances(cloud, mesh))


def _samples(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
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


def point_triangle_distance(
    points: NDArray[np.float64], triangles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N,) distances of points (N, 3) to triangles (N, 3, 3), row by row."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    size = np.einsum("ij,ij->i", normal, normal)
    safe = np.maximum(size, 1e-24)
    to = points - a
    v = np.einsum("ij,ij->i", np.cross(to, c - a), normal) / safe
    w = np.einsum("ij,ij->i", np.cross(b - a, to), normal) / safe
    inside = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (size > 1e-24)
    above = np.abs(np.einsum("ij,ij->i", to, normal)) / np.sqrt(safe)
    at_edge = np.minimum.reduce([_to_edge(points, *ends) for ends in ((a, b), (b, c), (c, a))])
    return np.asarray(np.where(inside, above, at_edge))


def _to_edge(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    way = end - start
    length = np.maximum(np.einsum("ij,ij->i", way, way), 1e-24)
    share = np.clip(np.einsum("ij,ij->i", points - start, way) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * way, axis=1))
