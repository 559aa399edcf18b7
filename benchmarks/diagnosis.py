"""Simulated logs, each wrong in one way: does `inspect log` say so, by how much, and what to do?

python benchmarks/diagnosis.py [WORLD...] [--only FAULT]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from robust.ailments import Entry, Spoil, depth, each, nothing_of, restamped

from mapmyworld import MemoryLog
from mapmyworld.config import Config
from mapmyworld.diagnosis import Finding, diagnose
from mapmyworld.geometry.rigid import make_transform
from mapmyworld.geometry.rotations import roll_pitch_yaw_to_rotation
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.simulation import SimulationSettings, simulate
from mapmyworld.simulation.worlds import find_world
from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    OdometryMessage,
    TransformsMessage,
    TransformStamped,
)

ROUTES = {
    "apartment": "turn:60 0.8,0.2 turn:-90 turn:90 1.6,-0.3 turn:45 turn:-45",
    "hall": "3,0 turn:60 turn:-60 4,0.5 turn:90 4,2 turn:-40",
    "office": "3,0 turn:60 turn:-60 6,0.3 turn:-40 turn:40 8,0",
    "corridor": "3,0 turn:60 turn:-60 6,0.3 turn:-40 turn:40 8,0",
}


def drive(world: str) -> list[Entry]:
    """A short drive with all sensors; images are small and raw."""
    settings = SimulationSettings()
    camera = replace(settings.camera, width=320, height=240, rate=5.0, compressed=False)
    settings = replace(settings, camera=camera, laser=replace(settings.laser, beams=541))
    made = simulate(find_world(world), seed=2, route=ROUTES[world], settings=settings)
    return list(made.messages())


def stamped(late_s: float, *kinds: type[Any]) -> Spoil:
    """The header stamps of some kinds of message lie so much too late."""
    return restamped(lambda stamp_ns, _: stamp_ns + int(late_s * 1e9), *kinds)


def scaled(factor: float) -> Spoil:
    return depth(lambda cells: cells * np.float32(factor))


def without_laser(factor: float) -> Spoil:
    """The depth images are changed, and there is nothing beside them."""
    return lambda entries: scaled(factor)(nothing_of(LaserScanMessage)(entries))


def mounted(sensor: str, shift: tuple[float, float, float], yaw: float = 0.0) -> Spoil:
    """By tf, the LASER or the CAMERA sits elsewhere on its parent than it does."""
    turn = roll_pitch_yaw_to_rotation(0.0, 0.0, float(np.radians(yaw)))

    def placed(t: TransformStamped) -> TransformStamped:
        """Shifted along the parent's axes and turned about the frame's own place."""
        pose = t.parent_from_child
        moved = make_transform(turn @ pose[:3, :3], pose[:3, 3] + shift)
        return replace(t, parent_from_child=moved)

    def spoil(entries: list[Entry]) -> list[Entry]:
        name = frames_of(entries)[sensor]

        def change(message: TransformsMessage, _: int) -> TransformsMessage:
            if not message.static:
                return message
            moved = (placed(t) if t.child == name else t for t in message.transforms)
            return replace(message, transforms=tuple(moved))

        return each(TransformsMessage, change)(entries)

    return spoil


def wheels(factor: float) -> Spoil:
    scale = np.array([[1.0, 1.0, 1.0, factor]] * 3 + [[1.0] * 4])
    return each(OdometryMessage, lambda message, _: replace(message, pose=message.pose * scale))


def silent_laser(entries: list[Entry]) -> list[Entry]:
    """From second 6 to 10."""
    start = entries[0][2]
    return [
        e
        for e in entries
        if not (isinstance(e[1], LaserScanMessage) and 6.0 <= (e[2] - start) * 1e-9 < 10.0)
    ]


# Name -> how a log is made wrong, a word of the line that must say so, and its value.
FAULTS: dict[str, tuple[Spoil, str, float | None]] = {
    "sound": (list, "", None),
    "odometry 0.12 s late": (
        stamped(0.12, OdometryMessage), "time offset of odometry to laser", 0.12),
    "gyroscope 0.1 s early": (
        stamped(-0.1, ImuMessage), "time offset of gyroscope to laser", -0.1),
    "camera 0.15 s late": (
        stamped(0.15, ImageMessage, CameraInfoMessage), "time offset of odometry to camera",
        -0.15),
    "laser 40 s ahead": (stamped(40.0, LaserScanMessage), "clocks disagree", None),
    "odometry 10 % long": (wheels(1.1), "odometry scale", 1 / 1.1),
    "depth 1.2 times": (scaled(1.2), "depth scale", 1.2),
    "depth in metres as mm": (scaled(0.001), "depth scale", 0.001),
    "depth in mm as m": (scaled(1000.0), "depth scale", 1000.0),
    "depth in 1/5000 m as mm": (scaled(5.0), "depth scale", 5.0),
    "sound, no laser": (nothing_of(LaserScanMessage), "", None),
    "no laser, depth 1.3 times": (without_laser(1.3), "depth scale", 1.3),
    "no laser, depth in 1/5000 m as mm": (without_laser(5.0), "depth scale", 5.0),
    "depth moved 7 pixels": (
        depth(lambda cells: np.roll(cells, 7, axis=1)), "camera and depth", 7.0),
    "laser 0.2 m ahead": (mounted("LASER", (0.2, 0.0, 0.0)), "scan against depth", None),
    "laser turned 6 deg": (mounted("LASER", (0.0, 0.0, 0.0), 6.0), "scan against depth", None),
    "camera 0.15 m left": (mounted("CAMERA", (0.0, 0.15, 0.0)), "scan against depth", None),
    "camera 0.1 m high": (mounted("CAMERA", (0.0, 0.0, 0.1)), "floor tilt", None),
    "no tf": (nothing_of(TransformsMessage), "no transform from", None),
    "laser stops 4 s": (silent_laser, "silent for 4", None),
}  # fmt: skip


def frames_of(entries: list[Entry]) -> dict[str, str]:
    """LASER and CAMERA -> the frames that carry them on the robot."""
    scan = next(m for _, m, _ in entries if isinstance(m, LaserScanMessage))
    image = next(m for _, m, _ in entries if isinstance(m, ImageMessage))
    parents = {
        t.child: t.parent
        for _, m, _ in entries
        if isinstance(m, TransformsMessage) and m.static
        for t in m.transforms
    }
    return {"LASER": scan.frame_id, "CAMERA": parents.get(image.frame_id, image.frame_id)}


def reported(entries: list[Entry]) -> tuple[dict[str, Finding], list[str]]:
    """The comparisons by name, and all other words about the log."""
    log = MemoryLog(entries)
    plan = make_plan(survey_log(log), Config().sensing)
    found = {finding.name: finding for finding in diagnose(log, plan, Config())}
    return found, [*plan.losses, *plan.warnings]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("worlds", nargs="*", default=list(ROUTES))
    parser.add_argument("--only", default="", help="faults whose name contains this")
    options = parser.parse_args()
    for world in options.worlds:
        entries = drive(world)
        for name in FAULTS:
            if options.only in name:
                print("\n".join(report(world, name, entries)), flush=True)


def report(world: str, name: str, entries: list[Entry]) -> list[str]:
    """Whether the fault is reported, and every line that is no praise."""
    fault, where, value = FAULTS[name]
    found, words = reported(fault(entries))
    bad = {key: finding for key, finding in found.items() if not finding.good}
    lines = [f"    {key}: {one.text} -> {one.suggestion}" for key, one in bad.items()]
    lines += [f"    - {word}" for word in words]
    if not where:
        verdict = f"{len(found)} comparisons, {len(bad)} complaints"
    elif value is None:
        verdict = (
            "reported" if where in bad or any(where in word for word in words) else "NOT REPORTED"
        )
    elif where not in bad:
        verdict = f"NOT REPORTED ({found[where].value:.3f})" if where in found else "NOT COMPARED"
    else:
        verdict = f"{bad[where].value:.3f} for {value:.3f}"
    return [f"{world}: {name}: {verdict}", *lines]


if __name__ == "__main__":
    main()
