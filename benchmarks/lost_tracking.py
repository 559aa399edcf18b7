"""Maps of drives on which tracking is lost: robots carried off, blinded, covered, slipping.

    python benchmarks/lost_tracking.py 0 8                       # drives 0 to 7
    python benchmarks/lost_tracking.py 3 --kind carried --world office
    python benchmarks/lost_tracking.py 14 18 --world office --kind blind --laser-only --losses 0

The last ones are spoilt nowhere: a laser alone.

Each drive is one through a simulated world, two laps, of which some sections are spoilt:

carried  nothing is recorded of 2 m and more, and the wheels stand still: lifted and put elsewhere
blind    no beam comes back, and the wheels wander
covered  something hangs before the laser, 0.3 m away all round, and the wheels wander
passing  the same for up to a second, ten times as often, with sound wheels: somebody goes by
spinning the laser sees, the wheels slip: they report another turn and of twice the way
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cli.scoring import score_loops
from mapmyworld.api import Built, build
from mapmyworld.config import Config
from mapmyworld.evaluation.nees import map_nees
from mapmyworld.evaluation.trajectory_error import ate
from mapmyworld.geometry.planar import planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.memory_log import MemoryLog
from mapmyworld.places.laser_nodes import joined_sessions, load_node_scans
from mapmyworld.simulation import Recording, SimulationSettings, simulate
from mapmyworld.simulation.message_streams import ODOMETRY_TOPIC, TF_TOPIC
from mapmyworld.types import (
    LaserScanMessage,
    Message,
    OdometryMessage,
    Trajectory,
    TransformsMessage,
)

Array = NDArray[np.float64]
KINDS = ("carried", "blind", "covered", "passing", "spinning")
WORLDS = ("apartment", "office", "hall")
_LENGTH = 2.0  # m of path at least that a spoilt section covers
_APART = 10.0  # s between two of them
_PASSING = 1.0  # s that somebody stands before the laser, at most; and how much more often
_OFTEN = 10
_WANDER = np.array([0.5, 0.3])  # share of the way and of the turn by which wheels wander
_COVER = 0.3  # m


@dataclass(frozen=True)
class Section:
    """From when to when, seconds, something is wrong; and what the wheels make of motions then."""

    kind: str
    start: float
    end: float
    distance: float
    turn: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("first", type=int)
    parser.add_argument("end", type=int, nargs="?", help="one beyond the last; one without")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--world", choices=WORLDS)
    parser.add_argument("--losses", type=int, default=3)
    parser.add_argument("--beams", type=int, default=181)
    parser.add_argument("--laser-only", action="store_true", help="without odometry")
    options = parser.parse_args()
    print(
        "| drive | world | spoilt | ATE m | max m | deg | components | ATE within m "
        "| closures | wrong | lost scans | NEES |\n" + "| --- " * 12 + "|"
    )
    for number in range(options.first, options.end or options.first + 1):
        for world in [options.world] if options.world else WORLDS:
            for kind in [options.kind] if options.kind else KINDS:
                print(row(number, world, kind, options), flush=True)


def row(number: int, world: str, kind: str, options: argparse.Namespace) -> str:
    """One drive's line of the table."""
    settings = SimulationSettings()
    laser = replace(settings.laser, beams=options.beams, field_of_view=180.0, range_max=12.0)
    settings = replace(settings, laser=laser, camera=replace(settings.camera, enabled=False))
    recording = simulate(world, seed=number, laps=2, settings=settings)
    sections = drawn(recording, kind, options.losses, np.random.default_rng(number))
    messages = spoilt(recording, sections)
    without = (ODOMETRY_TOPIC, TF_TOPIC) if options.laser_only else ()
    built = build(MemoryLog([message for message in messages if message[0] not in without]))
    truth = recording.truth.trajectory
    frames = built.map.frame_poses()
    assert frames is not None
    stamps = built.map.tracked_frames().stamps_ns
    moments = (stamps - recording.truth.start_ns) * 1e-9
    sound = np.array([spoils_at(moment, sections) is None for moment in moments.tolist()])
    score = ate(Trajectory(stamps[sound], frames[sound]), truth)
    right = score_loops(built.map, truth, None).right
    poses = built.map.poses()
    assert poses is not None
    nees = map_nees(built.map.nodes(), poses, truth)
    components = connected_components_of(built)[sound]
    within = [ate(Trajectory(stamps[sound][k], frames[sound][k]), truth).translation.rmse
              for k in (components == one for one in np.unique(components))]  # fmt: skip
    sizes = np.unique(components, return_counts=True)[1]
    inside = np.sqrt(np.average(np.square(within), weights=sizes))
    lost = sum(getattr(c.source, "state", "") == "odometry only" for c in built.map.constraints())
    return (
        f"| {number} | {world} | {kind} | {score.translation.rmse:.4f} | "
        f"{score.translation.maximum:.3f} | {score.rotation_deg.rmse:.2f} | {len(sizes)} | "
        f"{inside:.4f} | {len(right)} | {(~right).sum()} | {lost} | {nees or np.nan:.1f} |"
    )


def drawn(
    recording: Recording, kind: str, losses: int, random: np.random.Generator
) -> list[Section]:
    """Sections at moments drawn at random, each as long as the robot takes for its way."""
    times = np.arange(0.0, recording.duration, 0.1)
    places = recording.truth.drive.at(times)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))])
    found: list[Section] = []
    often = _OFTEN if kind == "passing" else 1
    while len(found) < losses * often:
        start = random.uniform(0.1, 0.9) * recording.duration
        at = float(np.interp(start, times, path))
        end = float(np.interp(at + _LENGTH, path, times))
        if kind == "passing":
            end = start + random.uniform(0.0, _PASSING)
        if all(end + _APART / often < s.start or s.end + _APART / often < start for s in found):
            distance, turn = 1.0 + random.choice([-1.0, 1.0], 2) * _WANDER
            if kind == "spinning":
                distance, turn = 2.0, float(random.choice([-0.5, 2.0]))
            elif kind == "carried":
                distance, turn = 0.0, 0.0
            elif kind == "passing":
                distance, turn = 1.0, 1.0
            found.append(Section(kind, start, end, float(distance), float(turn)))
    return found


def spoilt(recording: Recording, sections: list[Section]) -> Iterator[tuple[str, Message, int]]:
    """The recording's messages, spoilt in these sections."""
    start_ns = recording.truth.start_ns
    wheels = [
        message
        for _, message, _ in recording.messages([ODOMETRY_TOPIC])
        if isinstance(message, OdometryMessage)
    ]
    stamps = np.array([m.stamp_ns for m in wheels])
    poses = wandered(np.stack([m.pose for m in wheels]), (stamps - start_ns) * 1e-9, sections)
    pose_at = dict(zip(stamps.tolist(), poses, strict=True))
    for topic, message, log_time_ns in recording.messages():
        if isinstance(message, LaserScanMessage):
            spoils = spoils_at((message.stamp_ns - start_ns) * 1e-9, sections)
            if spoils is not None and spoils.kind == "carried":
                continue
            if spoils is not None and spoils.kind in ("blind", "covered", "passing"):
                value = np.inf if spoils.kind == "blind" else _COVER
                message = replace(message, ranges=np.full_like(message.ranges, value))
        elif isinstance(message, OdometryMessage):
            message = replace(message, pose=pose_at[message.stamp_ns])
        elif isinstance(message, TransformsMessage) and topic == TF_TOPIC:
            first, *others = message.transforms
            first = replace(first, parent_from_child=pose_at[first.stamp_ns])
            message = replace(message, transforms=(first, *others))
        yield topic, message, log_time_ns


def spoils_at(moment: float, sections: list[Section]) -> Section | None:
    """The section around a moment, seconds since the start."""
    return next((s for s in sections if s.start <= moment <= s.end), None)


def wandered(poses: Array, moments: Array, sections: list[Section]) -> Array:
    """Odometry (N, 4, 4) whose wheels report another way and turn in these sections."""
    steps = between(poses[:-1], poses[1:])
    result = [poses[0]]
    for step, moment in zip(steps, moments[1:].tolist(), strict=True):
        spoils = spoils_at(moment, sections)
        if spoils is not None:
            turn = np.arctan2(step[1, 0], step[0, 0])
            forward = spoils.distance * np.hypot(*step[:2, 3])
            wander = 0.5 * (spoils.distance != 0.0) * (spoils.turn - 1.0) * forward
            step = planar_to_matrix(np.array([forward, 0.0, spoils.turn * turn + wander]))
        result.append(result[-1] @ step)
    return np.stack(result)


def connected_components_of(built: Built) -> NDArray[np.int64]:
    """(F,) the connected component of each scan; relative poses between them are unknown."""
    loaded = load_node_scans(built.map, Config())
    ids = np.array([node.id for node in loaded.nodes])
    session = joined_sessions(loaded, built.map.constraints())
    at = np.searchsorted(ids, built.map.tracked_frames().node_ids, side="right") - 1
    return np.asarray(session[np.maximum(at, 0)], np.int64)


if __name__ == "__main__":
    main()
