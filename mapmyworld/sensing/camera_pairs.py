"""Which depth image and which calibration belong to a colour image."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from mapmyworld.sensing.plan import Draft
from mapmyworld.sensing.survey import Stream
from mapmyworld.sensing.transforms import frame_name
from mapmyworld.types import CameraInfoMessage, ImageMessage

_UNREGISTERED = 0.02  # of the image; calibrations of one lens differ by less, of two by more
Calibration = tuple[Stream, CameraInfoMessage]
"""A stream of calibrations and its first one."""


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """A stream of images and what its first message shows."""

    stream: Stream
    sample: ImageMessage
    width: int
    height: int
    grey_bits: int = 0
    """Of a 16-bit grey image, see `CameraSource`."""

    @property
    def topic(self) -> str:
        """The stream's."""
        return self.stream.topic


def score_pair(colour: Images, depth: Images, infos: list[Calibration]) -> float:
    """How well a depth image fits a colour image; 0 or less: not at all."""
    if colour.width * depth.height != colour.height * depth.width:
        return -1.0
    if _calibrated_apart(colour, depth, infos) > _UNREGISTERED:
        return -1.0
    same_frame = frame_name(colour.sample.frame_id) == frame_name(depth.sample.frame_id)
    registered = any(word in depth.topic for word in ("aligned", "register"))
    rate = min(colour.stream.frequency, depth.stream.frequency) / max(
        colour.stream.frequency, depth.stream.frequency, 1e-9
    )
    shared = _shared(colour.topic, depth.topic)
    is_colour = colour.sample.encoding.lower() not in {"mono8", "8uc1"}
    same_size = colour.width == depth.width
    return 2.0 * same_frame + 2.0 * registered + rate + shared + is_colour + same_size


def _calibrated_apart(colour: Images, depth: Images, infos: list[Calibration]) -> float:
    """How far the borders of depth lie from those of colour by the calibrations of their frames,
    as a share of the image; 0 where they have one frame, or one of them no calibration.
    """
    (f, c), (depth_f, depth_c) = (_lens_of(images, infos) for images in (colour, depth))
    borders = np.array([[0.0], [1.0]])
    with np.errstate(all="ignore"):  # of numbers that no lens has
        apart = np.abs((borders - depth_c) / depth_f * f + c - borders).max()
    return float(apart) if np.isfinite(apart) else 0.0


def _lens_of(images: Images, infos: list[Calibration]) -> NDArray[np.float64]:
    """Focal lengths and centre (2, 2) as shares of the image, NaN where its frame has none."""
    for _, info in infos:
        k = info.intrinsics
        if frame_name(info.frame_id) == frame_name(images.sample.frame_id) and k.diagonal().all():
            size = np.array([info.width or images.width, info.height or images.height])
            return np.asarray(np.stack([np.diag(k)[:2], k[:2, 2]]) / size)
    return np.full((2, 2), np.nan)


def _shared(topic: str, other: str) -> float:
    """Share of a topic's name that another begins with as well."""
    same = takewhile(lambda pair: pair[0] == pair[1], zip(topic, other, strict=False))
    return sum(1 for _ in same) / max(len(topic), 1)


def info_for(draft: Draft, colour: Images, infos: list[Calibration]) -> Calibration:
    """The camera info of the colour image: same frame, size and name, in this order."""
    wanted = draft.config.camera_info_topic

    def fit(candidate: Calibration) -> float:
        stream, info = candidate
        same_frame = frame_name(info.frame_id) == frame_name(colour.sample.frame_id)
        same_size = (info.width, info.height) == (colour.width, colour.height)
        shared = _shared(stream.topic, colour.topic)
        return 10.0 * (stream.topic == wanted) + 2.0 * same_frame + same_size + shared

    return max(infos, key=fit)
