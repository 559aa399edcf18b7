"""The part of the plan that matches colour, depth and camera info."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import LogError
from mapmyworld.sensing.camera_pairs import Calibration, Images, info_for, score_pair
from mapmyworld.sensing.grey_images import bits_of, eight_bits, is_grey
from mapmyworld.sensing.plan import CameraSource, Draft, ScanSource
from mapmyworld.sensing.sensor_mounts import Mount, check_joint, mount_of
from mapmyworld.sensing.survey import Stream
from mapmyworld.sensing.transforms import frame_name
from mapmyworld.types import CameraInfoMessage, CameraModel, ImageMessage, MessageKind


def choose_camera(draft: Draft, base: str) -> CameraSource | None:
    """Colour, depth and camera info that fit together best; None when any is missing."""
    if not draft.config.use_images:
        draft.decide("camera", "", "switched off by sensing.use_images")
        return None
    images = images_of(draft)
    depths = _wanted(draft.config.depth_topic, [i for i in images if i.sample.is_depth])
    colours = _wanted(draft.config.colour_topic, [i for i in images if not i.sample.is_depth])
    infos = infos_of(draft)
    missing = [
        name
        for name, found in (("colour", colours), ("depth", depths), ("camera info", infos))
        if not found
    ]
    if missing:
        _explain_missing(draft, missing, images)
        return None
    return _best(draft, base, colours, depths, infos)


def images_of(draft: Draft) -> list[Images]:
    """All streams of images that show something."""
    found = [seen for s in draft.survey.of_kind(MessageKind.IMAGE) if (seen := look_at(s))]
    depths = [(i.topic, i.sample.encoding) for i in found if i.sample.is_depth]
    for k, images in enumerate(found):
        if _is_grey(draft, images, depths):
            bits = bits_of(images.stream.samples)
            found[k] = replace(images, sample=eight_bits(images.sample, bits), grey_bits=bits)
    return found


def _is_grey(draft: Draft, images: Images, depths: list[tuple[str, str]]) -> bool:
    """Whether an image is a 16-bit picture, as the user says or as its name and others indicate."""
    if images.topic == draft.config.depth_topic:
        return False
    if images.topic == draft.config.colour_topic:
        return images.sample.encoding.lower() == "mono16"
    return is_grey(images.topic, images.sample.encoding, depths)


def infos_of(draft: Draft) -> list[Calibration]:
    """All streams of calibrations that hold one, by topic."""
    streams = draft.survey.of_kind(MessageKind.CAMERA_INFO)
    return [(s, info) for s in streams if (info := s.first(CameraInfoMessage)) is not None]


def look_at(stream: Stream) -> Images | None:
    """A stream of images and their size; None where none of the sample can be decoded."""
    sample = stream.first(ImageMessage)
    if sample is None:
        return None
    width, height = sample.width, sample.height
    if not width or not height:
        try:
            height, width = sample.pixels().shape[:2]
        except LogError:
            return None
    return Images(stream, sample, width, height)


def _wanted(topic: str, images: list[Images]) -> list[Images]:
    return [i for i in images if topic in {"", i.topic}]


def _explain_missing(draft: Draft, missing: list[str], images: list[Images]) -> None:
    what = " and ".join(missing)
    unread = _unreadable(draft)
    draft.losses += unread
    if not images and unread:
        draft.decide("camera", "", "its images cannot be decoded")
        return
    if not images:
        draft.problems.append("no camera images in the log")
        draft.decide("camera", "", "no images in the log")
        return
    line = f"the camera is not used: the log has images ({images[0].topic}) but no {what}"
    suggestion = {
        "camera info": "record the camera_info topic beside the images",
        "depth": "record a depth image registered to the colour image",
        "colour": "record the colour image beside the depth image",
    }[missing[-1]]
    draft.losses.append(f"{line}: {suggestion}")
    draft.decide("camera", "", f"no {what}")


def _unreadable(draft: Draft) -> list[str]:
    """The streams of images of which nothing is seen, each with the reason."""
    found = []
    for stream in draft.survey.of_kind(MessageKind.IMAGE):
        sample = stream.first(ImageMessage)
        try:
            if sample is not None:
                sample.pixels()
        except LogError as error:
            found.append(f"{stream.topic}: {error}")
    return found


def _best(
    draft: Draft, base: str, colours: list[Images], depths: list[Images], infos: list[Calibration]
) -> CameraSource | None:
    pairs = sorted(
        ((score_pair(c, d, infos), c, d) for c in colours for d in depths),
        key=lambda item: (-item[0], item[1].topic, item[2].topic),
    )
    score, colour, depth = pairs[0]
    if score <= 0:
        draft.losses.append(
            f"the camera is not used: {depth.topic} ({depth.width}x{depth.height}) is not "
            f"registered to {colour.topic} ({colour.width}x{colour.height}): record it registered, "
            "by align_depth or depth_registration of its driver"
        )
        draft.decide("camera", "", "no depth image fits a colour image")
        return None
    info_stream, info = info_for(draft, colour, infos)
    others = tuple(f"{c.topic} + {d.topic}: fits worse" for _, c, d in pairs[1:4])
    reason = (
        f"{depth.topic} and {info_stream.topic} fit it: {colour.width}x{colour.height}, "
        f"{colour.stream.frequency:.1f} Hz"
    )
    draft.decide("camera", colour.topic, reason, others)
    return source_of(draft, base, colour, depth, info_stream, info)


def source_of(
    draft: Draft,
    base: str,
    colour: Images,
    depth: Images,
    info_stream: Stream,
    info: CameraInfoMessage,
) -> CameraSource | None:
    """The camera of these topics; None, and why in the draft's losses, where it cannot serve."""
    fault = _fault_of(info, colour)
    if fault:
        draft.losses.append(f"the camera is not used: {info_stream.topic} holds {fault}")
        return None
    median = _median_depth(depth)
    if median > _FARTHEST_DEPTH:
        draft.losses.append(
            f"{depth.topic} measures {median:.0f} m in the median, farther than depth cameras see: "
            "record 32FC1 in metres or 16UC1 in millimetres"
        )
    frame_id = colour.sample.frame_id or info.frame_id
    mount = mount_of(draft, base, frame_id, "camera")
    check_joint(draft, base, frame_id, mount)
    if mount.is_assumed:
        draft.losses.append(
            f"no transform from {base} to {frame_name(colour.sample.frame_id) or 'the camera'}: "
            "the camera is assumed to look forward from the base; set sensing.camera_mount"
        )
        mount = Mount(_LOOKING_FORWARD)
    scale = np.diag([colour.width / (info.width or colour.width)] * 2 + [1.0])
    rectified = "rect" in colour.topic.rsplit("/", 2)[-1]
    model = CameraModel(
        width=colour.width,
        height=colour.height,
        intrinsics=scale
        @ (info.projection[:, :3] if rectified and info.projection[0, 0] > 0 else info.intrinsics),
        distortion_model="" if rectified else info.distortion_model,
        distortion=np.zeros(0) if rectified else info.distortion,
        base_from_camera=mount.base_from_sensor,
    )
    return CameraSource(colour.topic, depth.topic, model, colour.grey_bits)


def _median_depth(depth: Images) -> float:
    """Of the pixels of the first image that measure any; 0 without one, m."""
    try:
        metres = np.asarray(depth.sample.pixels(), np.float64)
    except LogError:
        return 0.0
    metres = metres[metres > 0.0]
    return float(np.median(metres)) if metres.size else 0.0


def _fault_of(info: CameraInfoMessage, colour: Images) -> str:
    """What makes a calibration useless; empty where it can be used."""
    k, p = info.intrinsics, info.projection
    finite = np.isfinite(k).all() and np.isfinite(info.distortion).all()
    if not (finite and k[0, 0] > 0 and k[1, 1] > 0):
        return "no intrinsics (uncalibrated)"
    if np.any(info.distortion) and len(info.distortion) not in _COEFFICIENTS:
        model = info.distortion_model or "no model"
        return f"{len(info.distortion)} distortion coefficients ({model}): no model has so many"
    largest = max(np.abs(x).max(initial=0) for x in (k, info.distortion, p[np.isfinite(p)]))
    if min(k[0, 0], k[1, 1]) < _LEAST_FOCAL or largest > _MOST:
        return "intrinsics out of range"
    if max(colour.width, colour.height) > CameraModel.longest_side:
        return f"images of {colour.width} x {colour.height} pixels, too large"
    return ""


def first_pose(camera: CameraSource | None, scan: ScanSource | None) -> NDArray[np.float64]:
    """Level, z up (4, 4): a base that is itself an optical frame starts looking forward."""
    if (
        scan is None
        and camera is not None
        and np.allclose(camera.model.base_from_camera, np.eye(4))
    ):
        return _LOOKING_FORWARD
    return np.eye(4)


_FARTHEST_DEPTH = 100.0  # m, several times what depth cameras measure
_LEAST_FOCAL, _MOST = 0.1, 1e6  # pixels; coefficients of distortion are far below as well
_COEFFICIENTS = (4, 5, 8, 12, 14)  # of plumb_bob, rational_polynomial, equidistant
_LOOKING_FORWARD = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
