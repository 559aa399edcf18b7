"""The features of a node's images that closures use."""

from __future__ import annotations

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
