"""Features of several cameras of one node, kept as RTAB-Map keeps them: images side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapmyworld.types import Features


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
