"""The part of the plan that chooses the base: the frame whose motion is mapped."""

from __future__ import annotations

from mapmyworld.sensing.plan import Draft
from mapmyworld.sensing.transforms import TransformTree, frame_name, is_called
from mapmyworld.types import MessageKind

BASES = ("base_footprint", "base_link", "robot_footprint", "base", "chassis", "body", "base_frame")
ODOMS = ("odom", "odom_combined", "odometry")
WORLDS = ("map", "world", "earth")


def choose_base(draft: Draft) -> str:
    """The child of the odometry, a frame with a usual name, or the topmost of the robot's."""
    wanted, tree = draft.config.base_frame, draft.survey.tree
    if wanted:
        draft.decide("base frame", wanted, "set by sensing.base_frame")
        return frame_name(wanted)
    moved = _moved(draft)
    for name, why in moved + [(name, "the usual name, found in tf") for name in _usual(tree)]:
        if _serves(draft, name):
            draft.decide("base frame", name, why)
            return name
    name, why = _without_names(draft, moved)
    draft.decide("base frame", name, why)
    return name


def _moved(draft: Draft) -> list[tuple[str, str]]:
    """The frames that odometry moves, and what says so: topics before tf."""
    topics = sorted(draft.survey.odometry_frames.items())
    found = [
        (frame_name(child), f"the child frame of {topic}") for topic, (_, child) in topics if child
    ]
    edges = [e for e in draft.survey.tree.edges() if is_called(e.parent, ODOMS)]
    return found + [(e.child, f"tf moves it under {e.parent}") for e in edges]


def _usual(tree: TransformTree) -> list[str]:
    """Frames with a usual name, then those with one behind a robot's: r1_base_link, r1/base.

    Not r1_base: arms and lasers have such bases too.
    """
    frames = sorted(tree.frames())
    plain = [base for base in BASES if base in frames]
    found = [f for base in BASES for f in frames if f.endswith(f"/{base}")]
    return plain + found + [f for b in BASES if "_" in b for f in frames if f.endswith(f"_{b}")]


def _without_names(draft: Draft, moved: list[tuple[str, str]]) -> tuple[str, str]:
    """The base where no frame that is known to be one carries a sensor."""
    sensors = sorted(_sensor_frames(draft))
    top = _topmost(draft, sensors[0]) if sensors else ""
    if moved and (top in {"", *sensors} or not draft.survey.odometry):
        name, why = moved[0]
        return name, f"{why}; tf connects no sensor with it"
    return (top, "the topmost frame above the sensor") if top else ("base_link", "default")


def _sensor_frames(draft: Draft) -> set[str]:
    """Frames of all lasers and cameras in the log."""
    kinds = (
        MessageKind.LASER_SCAN,
        MessageKind.CAMERA_INFO,
        MessageKind.IMAGE,
        MessageKind.POINT_CLOUD,
    )
    return {
        frame_name(sample.frame_id)
        for kind in kinds
        for stream in draft.survey.of_kind(kind)
        for sample in stream.samples[:1]
        if hasattr(sample, "frame_id") and sample.frame_id
    }


def _serves(draft: Draft, base: str) -> bool:
    """Whether some sensor hangs on this base, or no tf indicates otherwise."""
    sensors = _sensor_frames(draft)
    if not draft.survey.tree.frames() or not sensors:
        return True
    return any(base == s or draft.survey.tree.chain(base, s) is not None for s in sensors)


def _topmost(draft: Draft, frame: str) -> str:
    """The highest frame above a sensor that still moves with the robot: no odometry's, no map's."""
    chain = draft.survey.tree.ancestors(frame)
    edges = [draft.survey.tree.edge_to(name) for name in chain[:-1]]
    moves = [e.child for e in edges if e is not None and not e.is_fixed]
    moving = [name for name in moves if not is_called(name, ODOMS)]
    if moving:
        return moving[-1]
    return [n for n in chain if not is_called(n, (*ODOMS, *WORLDS))][-1] if chain[1:] else frame
