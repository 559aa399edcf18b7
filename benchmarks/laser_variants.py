"""Makes a log that nobody recorded of a CARMEN log, and the relations that it has to meet.

    python benchmarks/laser_variants.py LOG.clf.bz2 OUT.clf --backwards --every 2 --reach 8 --slip
    python benchmarks/laser_logs.py OUT.clf

Driven backwards, with every n-th scan (and those that relations name), with a laser that reaches
less far, is noisier or sees the middle third of its sweep alone, with wheels that slip, or that
report nothing from halfway on: LOG.relations, beside the log, becomes OUT.relations. The scans are
real, but what suits the recorded log need not suit these.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from formats.logs.files import open_binary
from mapmyworld.geometry.planar import between_planar, compose_planar

_NO_RETURN = 81.83  # what a SICK says
_LONGER, _WIDER = 1.04, 0.97  # what slipping wheels make of a step and of a turn
_DRIFT = np.radians(0.6)  # that they turn to one side in each metre


@dataclass(frozen=True)
class Change:
    backwards: bool
    every: int
    reach: float
    slip: bool
    noise: float
    third: bool
    dead: bool


@dataclass
class _Wheels:
    """Where wheels indicate that the robot is, and where they will say it once they slip."""

    slips: bool
    dies_after: float
    """Records, beyond which they say that it stands."""
    count: int = 0
    reported: np.ndarray | None = None
    slipped: np.ndarray | None = None

    def scan(self, laser: list[bytes], robot: list[bytes]) -> list[bytes]:
        """The laser's pose and the robot's, as far from each other as they were."""
        if not self.slips and np.isinf(self.dies_after):
            return laser + robot
        mount = between_planar(np.array(robot, np.float64), np.array(laser, np.float64))
        slipped = self.at(robot)
        return _words(compose_planar(np.array(slipped, np.float64), mount)) + slipped

    def at(self, words: list[bytes]) -> list[bytes]:
        if not self.slips and np.isinf(self.dies_after):
            return words
        self.count += 1
        pose = np.array(words, np.float64)
        if self.reported is None or self.slipped is None:
            self.slipped = pose
        else:
            step = between_planar(self.reported, pose)
            if self.slips:
                turn = _WIDER * step[2] + _DRIFT * np.hypot(step[0], step[1])
                step = np.array([*(_LONGER * step[:2]), turn])
            step = step if self.count < self.dies_after else np.zeros(3)
            self.slipped = compose_planar(self.slipped, step)
        self.reported = pose
        return _words(self.slipped)


def _words(pose: np.ndarray) -> list[bytes]:
    return [f"{value:.6f}".encode() for value in pose]


def records(log: Path, change: Change, kept: Collection[bytes]) -> Iterator[bytes]:
    """Lines of the changed log; scans with these stamps stay."""
    with open_binary(log) as stream:
        lines = stream.readlines()
    yield from (line for line in lines if line.startswith(b"PARAM"))
    moving = [line.split() for line in lines if line.startswith((b"FLASER ", b"ODOM "))]
    ends = _ends(moving)
    dies_after = 0.5 * len(moving) if change.dead else np.inf
    since, wheels = change.every, _Wheels(change.slip, dies_after)
    rng = np.random.default_rng(0)
    for words in reversed(moving) if change.backwards else moving:
        if words[0] == b"FLASER":
            since += 1
            count = 2 + int(words[1])
            robot = words[count + 3 : count + 6]
            words[count : count + 6] = wheels.scan(words[count : count + 3], robot)
            if since < change.every and words[-3] not in kept:
                continue
            since = 0
            words[2:count] = _seen(words[2:count], change, rng)
        else:
            words[1:4] = wheels.at(words[1:4])
        if change.backwards:
            words[-3] = words[-1] = _turned(words[-3], ends)
        yield b" ".join(words) + b"\n"


def _ends(moving: list[list[bytes]]) -> Decimal:
    """First and last stamp, added up."""
    stamps = [Decimal(words[-3].decode()) for words in moving]
    return min(stamps) + max(stamps)


def _turned(stamp: bytes, ends: Decimal) -> bytes:
    return f"{ends - Decimal(stamp.decode()):.6f}".encode()


def _seen(words: list[bytes], change: Change, rng: np.random.Generator) -> list[bytes]:
    ranges, beams = np.array(words, np.float64), np.arange(len(words))
    ranges[ranges > change.reach] = _NO_RETURN
    if change.third:
        ranges[abs(beams - beams.mean()) > len(beams) / 6.0] = _NO_RETURN
    if change.noise:
        returns = ranges < 80.0
        ranges[returns] += rng.normal(0.0, change.noise, np.count_nonzero(returns))
    return [f"{r:.2f}".encode() for r in np.maximum(ranges, 0.0)]


def relations(path: Path, log: Path, change: Change) -> Iterator[str]:
    """Lines of relations between the same places, at the stamps that these have now."""
    with open_binary(log) as stream:
        kinds = (b"FLASER ", b"ODOM ")
        ends = _ends([line.split() for line in stream if line.startswith(kinds)])
    for line in path.read_text().splitlines():
        words = line.split()
        if change.backwards:
            words[:2] = [_turned(word.encode(), ends).decode() for word in words[:2]]
        yield " ".join(words) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--backwards", action="store_true")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--reach", type=float, default=np.inf, metavar="METRES")
    parser.add_argument("--slip", action="store_true")
    parser.add_argument("--noise", type=float, default=0.0, metavar="METRES")
    parser.add_argument("--third", action="store_true")
    parser.add_argument("--dead", action="store_true")
    a = parser.parse_args()
    change = Change(a.backwards, a.every, a.reach, a.slip, a.noise, a.third, a.dead)
    known = a.log.with_name(a.log.name.split(".")[0] + ".relations")
    kept = {stamp for line in known.read_bytes().splitlines() for stamp in line.split()[:2]}
    with a.output.open("wb") as out:
        out.writelines(records(a.log, change, kept))
    with a.output.with_suffix(".relations").open("w") as text:
        text.writelines(relations(known, a.log, change))


if __name__ == "__main__":
    main()
