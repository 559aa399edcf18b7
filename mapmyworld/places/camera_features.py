"""Features of several cameras of one node, kept as RTAB-Map keeps them: images side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.types import Features


def joined_features(parts: Sequence[Features], width: int) -> Features:
    """The features of cameras 0, 1, ... as one, each one's u raised by `width` more pixels."""
    if len(parts) == 1:
        return parts[0]
    pixels = [_shifted(part, k * width) for k, part in enumerate(parts)]
    words = [part.words for part in parts if part.words is not None]
    return Features(
        np.concatenate(pixels),
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.sizes for part in parts]),
        np.concatenate([part.angles for part in parts]),
        np.concatenate([part.responses for part in parts]),
        np.concatenate([part.octaves for part in parts]),
        np.concatenate(words) if len(words) == len(parts) else None,
    )


def features_of_camera(features: Features, number: int, width: int) -> Features:
    """The features of one camera, in its own pixels."""
    own = np.floor(features.pixels[:, 0] / width).astype(np.int64) == number
    chosen = features if own.all() else select_features(features, np.flatnonzero(own))
    return replace(chosen, pixels=_shifted(chosen, -number * width)) if number else chosen


def _shifted(features: Features, by: int) -> NDArray[np.float32]:
    return features.pixels + np.array([by, 0], np.float32)


def select_features(features: Features, chosen: NDArray[np.int64]) -> Features:
    """The chosen features (K,), all parallel arrays alike."""
    return Features(
        features.pixels[chosen],
        features.points[chosen],
        features.descriptors[chosen],
        features.sizes[chosen],
        features.angles[chosen],
        features.responses[chosen],
        features.octaves[chosen],
        None if features.words is None else features.words[chosen],
    )
