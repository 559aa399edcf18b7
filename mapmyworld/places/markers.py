"""ArUco and AprilTag markers in the nodes' images: landmarks that cannot be confused."""

from __future__ import annotations

import cv2
import numpy as np

from mapmyworld.config import Config
from mapmyworld.errors import ConfigError
from mapmyworld.geometry import Array
from mapmyworld.geometry.rigid import invert, make_transform, se3_adjoint
from mapmyworld.parallel import in_threads
from mapmyworld.registration.camera_model import depth_at, rays_of_pixels
from mapmyworld.registration.camera_pose import Sightings, errors, refine_pose
from mapmyworld.registration.image_levels import grey_picture
from mapmyworld.types import (
    ConstraintKind,
    Judge,
    Judged,
    MapStore,
    Marker,
    NodeData,
    Progress,
    RgbdImage,
    Verdict,
    Why,
)

_CORNER_SIGMA = 0.7  # pixels, of a marker's corner
_WRONG = 5.0  # sigmas by which a corner may miss before the sighting is rejected
_UNIT = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


def find_markers(store: MapStore, config: Config, progress: Progress) -> list[Judged]:
    """A landmark constraint for every marker seen from a node; marker m is landmark -(m + 1).

    The marker's frame lies in its middle, x to the right, y up, z towards the viewer;
    `visual.markers` names the dictionary.
    """
    detector = _detector(config.visual.markers)
    nodes = store.nodes()
    progress.stage("markers", len(nodes), "nodes")
    data = (store.node_data(node.id) for node in nodes)
    found: list[Judged] = []

    def look(item: NodeData) -> list[tuple[int, Array, Array, float]]:
        return [s for image in item.images for s in _sightings(detector, image, config)]

    for node, seen in zip(nodes, in_threads(look, data, config.threads), strict=True):
        found += [_constraint(node.id, *sighting) for sighting in seen]
        progress.update(node.id)
    return found


def _detector(name: str) -> cv2.aruco.ArucoDetector:
    wanted = "DICT_" + name.upper()
    known = {key.upper(): key for key in dir(cv2.aruco) if key.startswith("DICT_")}
    if wanted not in known:
        names = ", ".join(sorted(key[5:].lower() for key in known))
        raise ConfigError(f'visual.markers is "{name}": choose one of {names}')
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known[wanted]))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _sightings(
    detector: cv2.aruco.ArucoDetector, image: RgbdImage, config: Config
) -> list[tuple[int, Array, Array, float]]:
    """Marker, base_from_marker, information and worst corner in sigmas of each one in view."""
    if image.colour is None:
        return []
    corners, ids, _ = detector.detectMarkers(grey_picture(image))
    if ids is None:
        return []
    found = []
    for marker, quad in zip(ids.ravel(), corners, strict=True):
        pixels = np.asarray(quad, np.float64).reshape(4, 2)
        length = config.visual.marker_length or _length_by_depth(image, pixels)
        if length > 0.0:
            found.append((int(marker), *_pose_of(image, pixels, length)))
    return found


def _length_by_depth(image: RgbdImage, pixels: Array) -> float:
    """The edge in metres, from depth along the outline just inside; 0 where there is too little."""
    if image.depth is None:
        return 0.0
    depth = np.asarray(image.depth.pixels(), np.float32)
    middle = pixels.mean(axis=0)
    share = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None]
    outline = np.concatenate(
        [a + share * (b - a) for a, b in zip(pixels, np.roll(pixels, -1, 0), strict=True)]
    )
    inside = middle + 0.85 * (outline - middle)
    z = depth_at(image, depth, inside)
    known = np.isfinite(z)
    if np.count_nonzero(known) < 12:
        return 0.0
    # A plane is linear in inverse depth over the rays, so that corners come from all of it.
    rays = rays_of_pixels(image.camera, inside[known])
    design = np.column_stack([rays, np.ones(len(rays))])
    plane = np.linalg.lstsq(design, 1.0 / z[known], rcond=None)[0]
    ends = rays_of_pixels(image.camera, pixels)
    inverse = np.column_stack([ends, np.ones(4)]) @ plane
    points = np.column_stack([ends, np.ones(4)]) / inverse[:, None]
    sides = np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1)
    return float(np.median(sides)) if np.all(inverse > 0) else 0.0


def _pose_of(image: RgbdImage, pixels: Array, length: float) -> tuple[Array, Array, float]:
    """base_from_marker, its information, and the worst corner's error in sigmas."""
    rays = rays_of_pixels(image.camera, pixels)
    points = _UNIT * length
    _, turn, shift = cv2.solvePnP(
        points, rays[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    camera_from_marker = make_transform(cv2.Rodrigues(turn)[0], np.asarray(shift).ravel())
    sigma = _CORNER_SIGMA / image.camera.intrinsics[0, 0]
    seen = np.column_stack([rays, np.full(4, np.nan)])
    sightings = Sightings(points, seen, np.tile([sigma, 1.0, 1.0], (4, 1)))
    marker_from_camera, information = refine_pose(invert(camera_from_marker), sightings)
    inverse = se3_adjoint(invert(marker_from_camera))
    worst = float(np.sqrt(errors(marker_from_camera, sightings)[:, 0].max()))
    base_from_marker = image.camera.base_from_camera @ invert(marker_from_camera)
    return base_from_marker, inverse.T @ information @ inverse, worst


def _constraint(node: int, marker: int, pose: Array, information: Array, worst: float) -> Judged:
    source = Marker(marker, float(np.linalg.norm(pose[:3, 3])), worst)
    numbers = {"marker": marker, "worst": worst, "limit": _WRONG}
    verdict = Verdict(Judge.CAMERA, worst < _WRONG, Why.MARKER_CORNERS, numbers)
    kind = ConstraintKind.LANDMARK
    return Judged(node, -(marker + 1), kind, pose, information, source, (verdict,))
