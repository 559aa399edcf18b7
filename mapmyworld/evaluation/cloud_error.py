"""How far a cloud lies from the true surfaces."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mapmyworld.errors import MapError
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.geometry import Array
from mapmyworld.types import Mesh, PointCloud

_NEIGHBOURS = 48  # triangles with the nearest part, of which the exact distance is taken
_CHUNK = 20_000  # points at a time, to bound memory
_LEAST_EDGE = 0.2  # m, the longest side of a part; longer ones in a large mesh,
_SQUARES = 40_000  # of which so many cover its area: it has some ten times as many parts
_HALVINGS = 40  # of an edge, more than any needs


def cloud_distances(cloud: PointCloud, mesh: Mesh) -> Array:
    """(N,) metres from each point to the nearest triangle of the mesh.

    Candidates come from the middles of small parts of the triangles; the distance to each is exact.
    """
    from trimesh.remesh import subdivide_to_size  # a second of a start, which few commands need
    from trimesh.triangles import area, closest_point

    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    edge = max(_LEAST_EDGE, float(np.sqrt(area(corners).sum() / _SQUARES)))
    split = subdivide_to_size(mesh.vertices, mesh.triangles, edge, _HALVINGS, return_index=True)
    vertices, parts, owners = split
    tree = cKDTree(vertices[parts].mean(axis=1))
    found = np.empty(len(cloud.points))
    count = min(_NEIGHBOURS, len(parts))
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
