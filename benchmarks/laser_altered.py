"""Makes logs that nobody recorded of a CARMEN log and its reference trajectory.

    python benchmarks/laser_altered.py LOG.clf.bz2 REFERENCE.tum OUT KIND... [--seed N]

    keys       a scan every 0.5 to 1 m of path, stamped 0.5 s apart; always together with wheels
    wheels     odometry of other wheels: scale, rotation a metre and noise of their own
    mount      a laser some 8 cm and 2 degrees from where the log says
    half       half of the scans, chosen at random
    gap        five stretches of 3 to 8 m without a scan
    blind      five stretches of 3 to 8 m in which the laser returns nothing
    stall      eight times the odometry stands for 2 to 5 scans, then catches up in one step
    people     four people around the robot in every scan
    glass      a seventh of all surfaces return nothing
    furniture  forty boxes that stand elsewhere in the second half of the drive

OUT.clf and OUT.ref.tum are written. What is done follows from the seed.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from formats.logs.files import open_binary
from formats.trajectory_files import read_trajectory
from mapmyworld.evaluation.relations_metric import poses_at
from mapmyworld.geometry.planar import between_planar, compose_planar, matrix_to_planar

KINDS = ("keys", "wheels", "mount", "half", "gap", "blind", "stall", "people", "glass", "furniture")
_NO_RETURN = 81.83  # what a SICK reports


@dataclass
class Drive:
    """Scans along a drive."""

    ranges: np.ndarray
    """(N, B) metres."""
    odometry: np.ndarray
    """(N, 3) odom_from_robot."""
    truth: np.ndarray
    """(N, 3) map_from_robot."""
    mount: np.ndarray
    """(3,) robot_from_laser."""
    stamps: np.ndarray
    """(N,) seconds."""
    starts: np.ndarray
    """(N,) angle of the first beam, in the laser's frame; lasers that interlace vary it."""
    resolution: float
    """Radians between beams."""

    def chosen(self, which: np.ndarray) -> Drive:
        """Some of the scans."""
        return Drive(
            self.ranges[which], self.odometry[which], self.truth[which], self.mount,
            self.stamps[which], self.starts[which], self.resolution,
        )  # fmt: skip

    @property
    def path(self) -> np.ndarray:
        """(N,) metres driven."""
        steps = np.hypot(*np.diff(self.truth[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def angles(self) -> np.ndarray:
        """(N, B) of the beams, in the laser's frame."""
        return self.starts[:, None] + self.resolution * np.arange(self.ranges.shape[1])

    @property
    def lasers(self) -> np.ndarray:
        """(N, 3) map_from_laser."""
        return compose_planar(self.truth, np.broadcast_to(self.mount, self.truth.shape))


def read(log: Path, reference: Path) -> Drive:
    """The scans of a log that the reference covers."""
    trajectory = read_trajectory(reference)
    first, last = (int(stamp) for stamp in trajectory.stamps_ns[[0, -1]])
    with open_binary(log) as stream:
        scans = [_scan(line.split()) for line in stream if line.startswith((b"FLASER", b"ROBOTL"))]
    usual = Counter(len(scan[0]) for scan in scans).most_common(1)[0][0]
    scans = [scan for scan in scans if len(scan[0]) == usual]
    columns = (np.array(column) for column in zip(*scans, strict=True))
    ranges, lasers, odometry, stamps, starts, resolutions = columns
    stamps_ns = (stamps * 1e9).round().astype(np.int64)
    covered = np.flatnonzero((stamps_ns >= first) & (stamps_ns <= last))
    truth = matrix_to_planar(poses_at(trajectory, stamps_ns[covered]))
    mount = between_planar(odometry[0], lasers[0])
    return Drive(
        ranges[covered], odometry[covered], truth, mount, stamps[covered], starts[covered],
        float(resolutions[0]),
    )  # fmt: skip


def _scan(words: list[bytes]) -> tuple[list[float], list[float], list[float], float, float, float]:
    """Ranges, the laser's pose, the robot's, the stamp, first angle and resolution of a FLASER or
    ROBOTLASER1 line.
    """
    if words[0] == b"FLASER":
        end = 2 + int(words[1])
        numbers = [float(word) for word in words[2 : end + 7]]
        step = np.pi / (int(words[1]) - int(words[1]) % 2)
        return numbers[:-7], numbers[-7:-4], numbers[-4:-1], numbers[-1], -0.5 * np.pi, step
    end = 9 + int(words[8])
    places = [float(word) for word in words[end + 1 + int(words[end]) :][:6]]
    ranges = [float(word) for word in words[9:end]]
    start, step = float(words[2]), float(words[4])
    return ranges, places[:3], places[3:], float(words[-3]), start, step


def write(drive: Drive, out: Path) -> None:
    """OUT.clf and OUT.ref.tum."""
    lasers = compose_planar(drive.odometry, np.broadcast_to(drive.mount, drive.odometry.shape))
    with out.with_suffix(".clf").open("w") as text:
        for start, ranges, laser, robot, stamp in zip(
            drive.starts, drive.ranges, lasers, drive.odometry, drive.stamps, strict=True
        ):
            beams = f"{start:.6f} {len(ranges) * drive.resolution:.6f} {drive.resolution:.6f}"
            places = " ".join(f"{value:.6f}" for value in (*laser, *robot))
            reported = " ".join(f"{value:.2f}" for value in ranges)
            text.write(
                f"ROBOTLASER1 0 {beams} {_NO_RETURN} 0.01 0 {len(ranges)} {reported} 0 {places} "
                f"0 0 0 0 0 {stamp:.6f} robot {stamp:.6f}\n"
            )
    with out.with_suffix(".ref.tum").open("w") as text:
        for (x, y, yaw), stamp in zip(drive.truth, drive.stamps, strict=True):
            half = 0.5 * yaw
            text.write(f"{stamp:.6f} {x:.6f} {y:.6f} 0 0 0 {np.sin(half):.9f} {np.cos(half):.9f}\n")


def keys(drive: Drive, random: np.random.Generator) -> Drive:
    which, least = [0], 0.5
    for k in range(1, len(drive.stamps)):
        moved = between_planar(drive.truth[which[-1]], drive.truth[k])
        if np.hypot(*moved[:2]) > least or abs(moved[2]) > least:
            which.append(k)
            least = random.uniform(0.5, 1.0)
    thin = drive.chosen(np.array(which))
    thin.stamps = 1e9 + 0.5 * np.arange(len(which))
    return wheels(thin, random)


def wheels(drive: Drive, random: np.random.Generator) -> Drive:
    steps = between_planar(drive.truth[:-1], drive.truth[1:])
    metres = np.hypot(*steps[:, :2].T)
    scale = 1.0 + random.normal(0.0, 0.03)
    pull = np.radians(random.choice([-1, 1]) * random.uniform(0.1, 1.0))
    noise = random.normal(size=steps.shape)
    steps[:, :2] *= scale + 0.03 * noise[:, :1]
    steps[:, 1] += 0.01 * metres * noise[:, 1]
    wobble = np.radians(0.5) * np.sqrt(metres) + 0.02 * np.abs(steps[:, 2])
    steps[:, 2] += pull * metres + wobble * noise[:, 2]
    odometry = np.zeros_like(drive.odometry)
    for k, step in enumerate(steps):
        odometry[k + 1] = compose_planar(odometry[k], step)
    drive.odometry = odometry
    return drive


def mount(drive: Drive, random: np.random.Generator) -> Drive:
    offset = random.normal(0.0, [0.08, 0.08, np.radians(2.0)])
    drive.odometry = compose_planar(drive.odometry, np.broadcast_to(offset, drive.odometry.shape))
    return drive


def half(drive: Drive, random: np.random.Generator) -> Drive:
    return drive.chosen(np.flatnonzero(random.random(len(drive.stamps)) < 0.5))


def _stretches(drive: Drive, random: np.random.Generator) -> np.ndarray:
    """(N,) whether a scan lies in one of the stretches."""
    path, inside = drive.path, np.zeros(len(drive.stamps), bool)
    for begin in random.uniform(5.0, path[-1] - 10.0, 5):
        inside |= (path > begin) & (path < begin + random.uniform(3.0, 8.0))
    return inside


def gap(drive: Drive, random: np.random.Generator) -> Drive:
    return drive.chosen(np.flatnonzero(~_stretches(drive, random)))


def blind(drive: Drive, random: np.random.Generator) -> Drive:
    drive.ranges[_stretches(drive, random)] = _NO_RETURN
    return drive


def stall(drive: Drive, random: np.random.Generator) -> Drive:
    for begin in random.integers(5, len(drive.stamps) - 10, 8):
        length = random.integers(2, 6)
        drive.odometry[begin : begin + length] = drive.odometry[begin]
    return drive


def _with_discs(drive: Drive, k: int, centres: np.ndarray, radius: float) -> None:
    """Beams of scan k end where discs (C, 2), in the laser's frame, stand in their way."""
    directions = np.stack([np.cos(drive.angles[k]), np.sin(drive.angles[k])], axis=1)
    along = centres @ directions.T
    beside = np.abs(centres[:, :1] * directions[:, 1] - centres[:, 1:] * directions[:, 0])
    hit = (along > 0.0) & (beside < radius)
    depth = np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    near = np.where(hit, along - depth, np.inf).min(axis=0, initial=np.inf)
    drive.ranges[k] = np.where((near > 0.1) & (near < drive.ranges[k]), near, drive.ranges[k])


def people(drive: Drive, random: np.random.Generator) -> Drive:
    for k in range(len(drive.stamps)):
        bearing, metres = random.uniform(-np.pi, np.pi, 4), random.uniform(0.8, 4.0, 4)
        centres = np.stack([metres * np.cos(bearing), metres * np.sin(bearing)], axis=1)
        _with_discs(drive, k, centres, 0.2)
    return drive


def glass(drive: Drive, random: np.random.Generator) -> Drive:
    clear = random.random((512, 512)) < 1.0 / 7.0
    for k, laser in enumerate(drive.lasers):
        turned = laser[2] + drive.angles[k]
        ends = laser[:2] + drive.ranges[k][:, None] * np.stack([np.cos(turned), np.sin(turned)], 1)
        cell = np.floor(ends / 0.5).astype(np.int64) % 512
        drive.ranges[k][clear[cell[:, 0], cell[:, 1]]] = _NO_RETURN
    return drive


def furniture(drive: Drive, random: np.random.Generator) -> Drive:
    spots = drive.truth[random.integers(0, len(drive.truth), 80), :2]
    bearing, metres = random.uniform(-np.pi, np.pi, 80), random.uniform(0.8, 2.5, 80)
    centres = spots + metres[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    for k, laser in enumerate(drive.lasers):
        there = centres[:40] if k < len(drive.stamps) // 2 else centres[40:]
        c, s = np.cos(laser[2]), np.sin(laser[2])
        _with_discs(drive, k, (there - laser[:2]) @ np.array([[c, -s], [s, c]]), 0.35)
    return drive


def altered(log: Path, reference: Path, out: Path, kinds: list[str], seed: int) -> Path:
    """The log changed in these ways, one after the other; OUT.clf."""
    drive, random = read(log, reference), np.random.default_rng(seed)
    for kind in kinds:
        drive = globals()[kind](drive, random)
    write(drive, out)
    return out.with_suffix(".clf")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("reference", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("kinds", nargs="+", choices=KINDS, metavar="KIND")
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    print(altered(a.log, a.reference, a.output, a.kinds, a.seed))


if __name__ == "__main__":
    main()
