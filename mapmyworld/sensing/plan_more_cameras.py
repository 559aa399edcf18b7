"""Further cameras of a robot that look elsewhere: their images join those of the first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry.rigid import between
from mapmyworld.geometry.rotations import rotation_angle
from mapmyworld.sensing.camera_pairs import Calibration, Images, info_for, score_pair
from mapmyworld.sensing.plan import CameraSource, Draft
from mapmyworld.sensing.plan_cameras import images_of, infos_of, source_of
from mapmyworld.sensing.sensor_mounts import mount_of
from mapmyworld.sensing.transforms import frame_name

_APART = (0.1, 0.17)  # m, rad by which another camera must differ from those before it
_BELONGS = 2.0  # score from which depth belongs to colour: one frame, or registered by name


def choose_more_cameras(
    draft: Draft, base: str, first: CameraSource | None
) -> tuple[CameraSource, ...]:
    """Colour cameras with a depth image, a calibration and a mount of their own.

    Only of the first one's size, as images of a node are kept side by side. None where the user
    named the images to use.
    """
    settings = draft.config
    if first is None or settings.colour_topic or settings.depth_topic or settings.camera_mount:
        return ()
    found = [first]
    images, used = images_of(draft), {first.colour_topic, first.depth_topic}
    infos = infos_of(draft)
    for colour in sorted(images, key=lambda i: i.topic):
        if colour.topic in used or not _is_like(colour, first):
            continue
        depth = _depth_of(colour, [i for i in images if i.topic not in used], infos)
        mount = mount_of(draft, base, colour.sample.frame_id, "camera")
        if depth is None or mount.is_assumed or mount.is_loose or not infos:
            continue
        stream, info = info_for(draft, colour, infos)
        if frame_name(info.frame_id) != frame_name(colour.sample.frame_id):
            continue  # it has no calibration of its own frame
        source = source_of(draft, base, colour, depth, stream, info)
        if source is not None and all(_is_apart(source, other) for other in found):
            found.append(source)
            used |= {colour.topic, depth.topic}
            reason = (
                f"{depth.topic} fits it; it looks in another direction than the cameras before it"
            )
            draft.decide("another camera", colour.topic, reason)
    return tuple(found[1:])


def _is_like(colour: Images, first: CameraSource) -> bool:
    """Whether a stream is colour of the first camera's size: an infrared image is its depth's."""
    grey = {"mono8", "8uc1", "mono16", "16uc1"}
    size = first.model.width, first.model.height
    plain = not colour.sample.is_depth and colour.sample.encoding.lower() not in grey
    return plain and (colour.width, colour.height) == size


def _depth_of(colour: Images, images: list[Images], infos: list[Calibration]) -> Images | None:
    """The depth image that fits best, if it is this camera's."""
    fitting = [(score_pair(colour, i, infos), i) for i in images if i.sample.is_depth]
    near = [(s, i) for s, i in fitting if s > _BELONGS and i.width == colour.width]
    return max(near, key=lambda item: (item[0], item[1].topic))[1] if near else None


def _is_apart(a: CameraSource, b: CameraSource) -> bool:
    motion: NDArray[np.float64] = between(a.model.base_from_camera, b.model.base_from_camera)
    far = float(np.linalg.norm(motion[:3, 3])) > _APART[0]
    return far or float(rotation_angle(motion)) > _APART[1]
