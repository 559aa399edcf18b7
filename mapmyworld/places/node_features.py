"""The features of a node's images that closures use.

Those of several cameras are kept as RTAB-Map keeps them: images side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.config import Config
from mapmyworld.registration.features import extract_features, spread
from mapmyworld.types import CameraModel, Features, NodeData, RgbdImage

Prepared = tuple[Features, CameraModel]


def usable_images(data: NodeData) -> list[RgbdImage]:
    """The images that have colour and depth."""
    return [image for image in data.images if image.colour is not None and image.depth is not None]


def prepared_image(image: RgbdImage, features: Features | None, config: Config) -> Prepared:
    """The features that closures use, found where they are not `features` known before."""
    wanted = config.visual.place_features
    found = features or extract_features(image, config, wanted)
    return best_features(found, image.camera, config), image.camera


def best_features(features: Features, camera: CameraModel, config: Config) -> Features:
    """The features that closures use: at most `visual.place_features`, spread over the image."""
    wanted = config.visual.place_features
    if len(features.pixels) <= wanted:
        return features
    chosen = spread(features.pixels, features.responses, camera.width, camera.height, wanted)
    return features.chosen(chosen)


def joined_features(parts: Sequence[Features], width: int) -> Features:
    """The features of cameras 0, 1, ... as one, each one's u raised by `width` more pixels."""
    first, *others = (_shifted(part, k * width) for k, part in enumerate(parts))
    return first.followed_by(*others)


def features_of_camera(features: Features, number: int, width: int) -> Features:
    """The features of one camera, in its own pixels."""
    own = np.floor(features.pixels[:, 0] / width).astype(np.int64) == number
    return _shifted(features if own.all() else features.chosen(own), -number * width)


def _shifted(features: Features, by: int) -> Features:
    return replace(features, pixels=features.pixels + np.array([by, 0], np.float32))
