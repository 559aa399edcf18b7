"""A camera's path where its local map slips beneath it.

A camera that comes back to an older part of its map is placed there at once, by as much as it has
drifted since. Its base did not move so: the last two images indicate, by themselves, how it did.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.config import Config
from mapmyworld.geometry.rigid import between, invert, se3_exp, se3_log
from mapmyworld.registration.image_pairs import register_images
from mapmyworld.registration.views import View
from mapmyworld.types import Registration

Array = NDArray[np.float64]
Known = tuple[Array, Array]
"""A motion (4, 4) and its covariance (6, 6), rotation first."""


class SteadyPath:
    """Poses in a frame of their own that map and base share until the first slip.

    State: where the map is in that frame, and the frame before: its image and pose.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._path_from_map = np.eye(4)
        self._view: View | None = None
        self._pose = np.eye(4)

    def reach(self, pose: Array, view: View | None) -> Array:
        """path_from_base (4, 4) at a pose (4, 4) in the map; it and its image are remembered."""
        self._view, self._pose = view or None, pose  # one without features indicates nothing
        return np.asarray(self._path_from_map @ pose)

    def is_matched(self, view: View) -> bool:
        """Whether this image has much in common with the one before."""
        return self._pair(view) is not None

    def undo_slip(self, view: View, seen: Known, expected: Known) -> Array | None:
        """Covariance (6, 6) of the motion to this frame, once a slip of the map is taken out.

        `seen`: the pose in the map, `expected`: that of inertia; a matrix (4, 4) and the covariance
        (6, 6) of the motion each. None where the images show that the base did jump, or where they
        show nothing; and for a slip that is less than takes a new keyframe: so much drift the map
        takes back rightly.
        """
        slip = se3_log(between(expected[0], seen[0]))
        if self._is_small(slip):
            return None
        pair = self._pair(view)
        if pair is None:
            return None
        direct = pair.a_from_b, np.asarray(np.linalg.inv(pair.information))
        jump, carried = ((between(self._pose, pose), known) for pose, known in (seen, expected))
        if normalised_residual(carried, direct) > normalised_residual(jump, direct):
            return None
        motion, covariance = together(carried, direct)
        self._path_from_map = self._path_from_map @ self._pose @ motion @ invert(seen[0])
        return covariance

    def _is_small(self, slip: Array) -> bool:
        turned, moved = np.linalg.norm(slip[:3]), np.linalg.norm(slip[3:])
        least = self._config.odometry
        return bool(turned < least.keyframe_angle and moved < least.keyframe_distance)

    def _pair(self, view: View) -> Registration | None:
        """The motion from the image before to this one by these two alone; None if unknown."""
        if self._view is None:
            return None
        pair = register_images(self._view, view, self._config).registration
        return pair if pair.inliers >= self._config.visual.closure_inliers else None


def normalised_residual(one: Known, other: Known) -> float:
    """Squared sigmas by which two motions (4, 4), with covariances (6, 6), differ."""
    off = se3_log(between(one[0], other[0]))
    return float(off @ np.linalg.solve(one[1] + other[1], off))


def together(one: Known, other: Known) -> Known:
    """What two measurements report of a motion together: (4, 4) with covariance (6, 6) each."""
    off = se3_log(between(one[0], other[0]))
    gain = np.linalg.solve(one[1] + other[1], one[1]).T
    covariance = one[1] - gain @ one[1]
    return one[0] @ se3_exp(gain @ off), 0.5 * (covariance + covariance.T)
