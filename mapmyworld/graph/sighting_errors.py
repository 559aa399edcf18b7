"""How far features are seen from where they are, and which sightings are too far off to be true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmyworld.geometry import Array
from mapmyworld.graph.bundle import Bundle

_FARTHEST = 3.0  # errors as they are usual, beyond which a sighting is of something else
_HALF = 1.1774  # sigmas within which half of all errors in the plane lie, sqrt(2 ln 2)
_HALF_OF_DEPTHS = 0.6745  # the same of errors along a line


def with_measured_errors(adjusted: Bundle) -> Bundle:
    """An adjusted bundle whose sigmas are as large as its errors, without its outliers.

    Expected sigmas have the right proportions, by scale and distance, but one factor for image
    positions and one for inverse depths are left to be found: half of all errors tell them,
    whatever the outliers. A point that one camera alone still sees says nothing and goes.
    """
    aside, deeper = _errors(adjusted)
    scale = [_ratio(aside, _HALF), _ratio(deeper[np.isfinite(deeper)], _HALF_OF_DEPTHS)]
    sigmas = np.array(adjusted.sigmas)
    sigmas[:, :2] *= scale
    agreed = (aside < _FARTHEST * scale[0]) & ~(deeper >= _FARTHEST * scale[1])
    agreed &= np.bincount(adjusted.point_of, agreed)[adjusted.point_of] > 1
    points, point_of = np.unique(adjusted.point_of[agreed], return_inverse=True)
    return replace(
        adjusted,
        points=adjusted.points[points],
        camera_of=adjusted.camera_of[agreed],
        point_of=point_of.astype(np.int64),
        seen=adjusted.seen[agreed],
        sigmas=sigmas[agreed],
    )


def _errors(bundle: Bundle) -> tuple[Array, Array]:
    """In expected sigmas: image position (M,), and inverse depth (M,), NaN where none was seen."""
    cameras = bundle.cameras[bundle.camera_of]
    away = bundle.points[bundle.point_of] - cameras[:, :3, 3]
    x, y, z = np.einsum("mji,mj->im", cameras[:, :3, :3], away)
    z = np.where(z > 0.0, z, np.nan)  # what lies behind a camera is no sighting of it
    aside = np.hypot(x / z - bundle.seen[:, 0], y / z - bundle.seen[:, 1]) / bundle.sigmas[:, 0]
    deeper = np.abs(1.0 / z - bundle.seen[:, 2]) / bundle.sigmas[:, 1]
    return np.nan_to_num(aside, nan=np.inf), deeper


def _ratio(errors: Array, half: float) -> float:
    """Standard deviation of errors by their median; 1 where there are none."""
    return float(np.median(errors)) / half if len(errors) else 1.0
