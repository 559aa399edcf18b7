"""What goes wrong with real recordings, message by message: each ailment spoils a sound drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from mapmyworld.types import (
    CameraInfoMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    Message,
    OdometryMessage,
    TransformsMessage,
    TransformStamped,
)

Entry = tuple[str, Message, int]
Spoil = Callable[[list[Entry]], list[Entry]]
M = TypeVar("M")
SECOND = 1_000_000_000
HOUR = 3600 * SECOND


@dataclass(frozen=True, slots=True)
class Ailment:
    """A spoiled log, the exit codes that are right for it, and words that must be said."""

    name: str
    spoil: Spoil
    exits: tuple[int, ...] = (0, 3)
    words: str = ""


def each(kind: type[M], change: Callable[[M, int], Any], *, topic: str = "") -> Spoil:
    """Changes the messages of a kind; `change` gets each with its number, None removes it."""

    def spoil(entries: list[Entry]) -> list[Entry]:
        found, count = list[Entry](), 0
        for name, message, time in entries:
            spoilt: Any = message
            if isinstance(message, kind) and topic in name:
                spoilt, count = change(message, count), count + 1
            if spoilt is not None:
                found.append((name, spoilt, time))
        return found

    return spoil


def restamped(change: Callable[[int, int], int], *kinds: type[Any]) -> Spoil:
    """New header stamps, of the old one and the message's number."""

    def spoil(entries: list[Entry]) -> list[Entry]:
        found = []
        for number, (name, message, time) in enumerate(entries):
            spoilt: Any = message
            if isinstance(message, kinds or object) and not isinstance(message, TransformsMessage):
                spoilt = replace(message, stamp_ns=change(message.stamp_ns, number))  # type: ignore[type-var]
            found.append((name, spoilt, time))
        return found

    return spoil


def _ranges(change: Callable[[np.ndarray, int], np.ndarray]) -> Spoil:
    return each(LaserScanMessage, lambda m, n: replace(m, ranges=change(m.ranges.copy(), n)))


def _every(step: int, value: float) -> Callable[[np.ndarray, int], np.ndarray]:
    def change(ranges: np.ndarray, _: int) -> np.ndarray:
        ranges[::step] = value
        return ranges

    return change


def _pose_with(value: float, every: int) -> Callable[[OdometryMessage, int], OdometryMessage]:
    def change(message: OdometryMessage, number: int) -> OdometryMessage:
        if number % every:
            return message
        pose = message.pose.copy()
        pose[0, 3] = value
        return replace(message, pose=pose)

    return change


def depth(pixels: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Depth images decoded, changed, and written raw again."""

    def change(message: ImageMessage, _: int) -> ImageMessage:
        made = pixels(message.pixels())
        return replace(
            message, encoding="32FC1", width=made.shape[1], height=made.shape[0],
            pixels=lambda: made, encoded=None,
        )  # fmt: skip

    return each(ImageMessage, change, topic="depth")


def _tiny(height: int, width: int) -> Spoil:
    """A camera of a few pixels, and no laser beside it."""

    def changed(message: Message) -> Message:
        if isinstance(message, CameraInfoMessage):
            return replace(message, width=width, height=height)
        if not isinstance(message, ImageMessage):
            return message
        made = message.pixels()[:height, :width].copy()
        encoding = "32FC1" if made.ndim == 2 else "rgb8"
        return replace(
            message, encoding=encoding, width=width, height=height, pixels=lambda: made,
            encoded=None,
        )  # fmt: skip

    return lambda entries: [
        (name, changed(message), time)
        for name, message, time in entries
        if not isinstance(message, LaserScanMessage)
    ]


def _broken_files(every: int) -> Spoil:
    """Compressed images whose bytes are damaged."""

    def change(message: ImageMessage, number: int) -> ImageMessage:
        if number % every or message.encoded is None:
            return message
        data = bytearray(message.encoded)
        data[len(data) // 2 :] = b"\0" * (len(data) - len(data) // 2)
        data[:24] = b"\0" * 24 if number % 2 else data[:24]
        return replace(message, encoded=bytes(data))

    return each(ImageMessage, change)


def _transforms_of(parent: str, child: str, times: Callable[[int], np.ndarray]) -> Spoil:
    """More transforms, ten a second."""

    def spoil(entries: list[Entry]) -> list[Entry]:
        start, end = entries[0][2], entries[-1][2]
        more = list[Entry]()
        for number, time in enumerate(range(start, end, SECOND // 10)):
            moved = TransformStamped(time, parent, child, times(number))
            more.append(("/tf", TransformsMessage((moved,), False), time))
        return sorted([*entries, *more], key=lambda entry: entry[2])

    return spoil


def _shifted(number: int) -> np.ndarray:
    """A transform that jumps by a hundred metres now and then."""
    pose = np.eye(4)
    pose[0, 3] = 100.0 if number % 7 == 0 else 0.01 * number
    return pose


def _between(first: float, last: float, *kinds: type[Any]) -> Spoil:
    """Only those messages of some kinds that lie in a part of the log."""

    def spoil(entries: list[Entry]) -> list[Entry]:
        start, end = entries[0][2], entries[-1][2]
        low, high = start + first * (end - start), start + last * (end - start)
        return [e for e in entries if not isinstance(e[1], kinds) or low <= e[2] <= high]

    return spoil


def _bursts(entries: list[Entry]) -> list[Entry]:
    """Nothing for a second, then all of it at one log time, as over a bad network."""
    found = [(n, m, t - t % SECOND + SECOND) for n, m, t in entries]
    return sorted(found, key=lambda entry: entry[2])


def _twice(entries: list[Entry]) -> list[Entry]:
    return [entry for entry in entries for _ in range(2)]


def _clock_set(stamp_ns: int, number: int) -> int:
    return stamp_ns - HOUR if number > 100 else stamp_ns


def nothing_of(*kinds: type[Any]) -> Spoil:
    return lambda entries: [e for e in entries if not isinstance(e[1], kinds)]


def _nan_imu(message: ImuMessage, number: int) -> ImuMessage:
    return replace(message, angular_velocity=np.full(3, np.nan)) if number % 3 else message


def _nan_transform(entries: list[Entry]) -> list[Entry]:
    pose = np.eye(4)
    pose[:3, 3] = np.nan
    return _transforms_of("odom", "stray", lambda _: pose)(entries)


def _pause(entries: list[Entry]) -> list[Entry]:
    """No scan in the middle of the log."""
    start, end = entries[0][2], entries[-1][2]
    shares = [(time - start) / (end - start) for _, _, time in entries]
    return [
        entry
        for entry, share in zip(entries, shares, strict=True)
        if not isinstance(entry[1], LASER) or not 0.3 < share < 0.8
    ]


def _scan(**changes: float) -> Spoil:
    """Every scan with these fields changed."""
    return each(LaserScanMessage, lambda m, _: replace(m, **changes))  # type: ignore[arg-type]


def _info(**changes: Any) -> Spoil:
    """Every camera info with these fields changed."""
    return each(CameraInfoMessage, lambda m, _: replace(m, **changes))


def _odometry(value: float, every: int) -> Spoil:
    return each(OdometryMessage, _pose_with(value, every))


def _turned_nowhere(message: LaserScanMessage, number: int) -> LaserScanMessage:
    return message if number % 3 else replace(message, angle_min=np.nan)


def _without_names(message: OdometryMessage, _: int) -> OdometryMessage:
    return replace(message, frame_id="", child_frame_id="")


def _without_depth(entries: list[Entry]) -> list[Entry]:
    return [e for e in entries if not (isinstance(e[1], ImageMessage) and e[1].is_depth)]


def _holes(depth: np.ndarray) -> np.ndarray:
    return np.where(depth > 2, np.nan, np.inf).astype(np.float32)


def _unknown_encoding(message: ImageMessage, _: int) -> ImageMessage:
    return replace(message, encoding="17ZX9", encoded=None)


def _loop(entries: list[Entry]) -> list[Entry]:
    """base_link -> laser -> odom, while odom -> base_link stands as well."""
    half = _transforms_of("base_link", "laser", lambda _: np.eye(4))(entries)
    return _transforms_of("laser", "odom", lambda _: np.eye(4))(half)


def _reversed(entries: list[Entry]) -> list[Entry]:
    """The last message first; log times run on."""
    pairs = zip(reversed(entries), entries, strict=True)
    return [(name, message, time) for (name, message, _), (_, _, time) in pairs]


def _once(entries: list[Entry]) -> list[Entry]:
    seen = False
    found = []
    for entry in entries:
        if isinstance(entry[1], CameraInfoMessage):
            if seen:
                continue
            seen = True
        found.append(entry)
    return found


def _first(entries: list[Entry], kind: type[Any], count: int = 1) -> list[Entry]:
    kept = [entry for entry in entries if isinstance(entry[1], kind)][:count]
    return [e for e in entries if not isinstance(e[1], kind | ImageMessage) or e in kept]


LASER, CAMERA = (LaserScanMessage,), (ImageMessage, CameraInfoMessage)

AILMENTS: tuple[Ailment, ...] = (
    Ailment("sound", lambda entries: entries, (0,)),
    Ailment("ranges NaN", _ranges(_every(5, np.nan))),
    Ailment("ranges infinite", _ranges(_every(5, np.inf))),
    Ailment("ranges minus infinite", _ranges(_every(5, -np.inf))),
    Ailment("ranges absurd", _ranges(_every(5, 3e38))),
    Ailment("ranges negative", _ranges(_every(5, -2.0))),
    Ailment("ranges all NaN", _ranges(_every(1, np.nan)), (2, 3)),
    Ailment("ranges of changing number", _ranges(lambda r, n: r[: len(r) - n % 40])),
    Ailment("ranges none, now and then", _ranges(lambda r, n: r[: 0 if n % 4 == 0 else len(r)])),
    Ailment("ranges never any", _ranges(lambda r, _: r[:0]), (2, 3)),
    Ailment("bearing NaN", each(LaserScanMessage, _turned_nowhere)),
    Ailment("bearings without step", _scan(angle_increment=0.0)),
    Ailment("beam times NaN", _scan(time_increment=np.nan)),
    Ailment("beam times of a year", _scan(time_increment=3e7)),
    Ailment("range limits NaN", _scan(range_min=np.nan, range_max=np.nan)),
    Ailment("range limits zero", _scan(range_min=0.0, range_max=0.0)),
    Ailment("odometry NaN now and then", _odometry(np.nan, 4)),
    Ailment("odometry infinite", _odometry(np.inf, 4)),
    Ailment("odometry absurd", _odometry(1e300, 4)),
    Ailment("odometry all NaN", _odometry(np.nan, 1)),
    Ailment("odometry jumps", _odometry(50.0, 9)),
    Ailment("odometry of no frame", each(OdometryMessage, _without_names)),
    Ailment("odometry stops", _between(0.0, 0.5, OdometryMessage), words="odometry"),
    Ailment("odometry starts late", _between(0.5, 1.0, OdometryMessage)),
    Ailment("laser stops", _between(0.0, 0.5, *LASER), words="before the log ends"),
    Ailment("laser starts late", _between(0.5, 1.0, *LASER)),
    Ailment("laser pauses", _pause),
    Ailment("camera stops", _between(0.0, 0.4, *CAMERA)),
    Ailment("camera starts late", _between(0.6, 1.0, *CAMERA)),
    Ailment("camera info only once", _once),
    Ailment(
        "camera info beyond sense",
        _info(intrinsics=np.diag([1e300, 1e300, 1.0])),
        (3,),
        "intrinsics out of range",
    ),
    Ailment(
        "camera info nearly zero",
        _info(intrinsics=np.diag([1e-300, 1e-300, 1.0])),
        (3,),
        "intrinsics out of range",
    ),
    Ailment(
        "distortion beyond sense",
        _info(distortion_model="plumb_bob", distortion=np.full(5, 1e30)),
        (3,),
        "intrinsics out of range",
    ),
    Ailment(
        "camera info zero",
        _info(intrinsics=np.zeros((3, 3)), projection=np.zeros((3, 4))),
        (3,),
        "no intrinsics",
    ),
    Ailment("camera info NaN", _info(intrinsics=np.full((3, 3), np.nan)), (3,), "no intrinsics"),
    Ailment("camera info of no size", _info(width=0, height=0)),
    Ailment("camera info of another size", _info(width=7, height=9000)),
    Ailment("camera info absent", nothing_of(CameraInfoMessage), (3,), "camera info"),
    Ailment("distortion NaN", _info(distortion=np.full(5, np.nan))),
    Ailment(
        "distortion of unknown model", _info(distortion_model="mystery", distortion=np.ones(17))
    ),
    Ailment("depth of half the size", depth(lambda p: p[::2, ::2].copy())),
    Ailment(
        "depth of another shape",
        depth(lambda p: p[:, :40].copy()),
        (3,),
        "not registered",
    ),
    Ailment("depth in millimetres as metres", depth(lambda p: p * 1000.0)),
    Ailment("depth NaN and infinite", depth(_holes)),
    Ailment("depth negative", depth(lambda p: -p)),
    Ailment("depth absent", _without_depth, (3,), "no depth"),
    Ailment("a camera of one pixel", _tiny(1, 1)),
    Ailment("a camera of two pixels", _tiny(2, 1)),
    Ailment("a camera of one row", _tiny(1, 64)),
    Ailment("images that do not decode", _broken_files(1)),
    Ailment("some images that do not decode", _broken_files(5)),
    Ailment("encoding unknown", each(ImageMessage, _unknown_encoding, topic="rgb")),
    Ailment("imu NaN", each(ImuMessage, _nan_imu)),
    Ailment("tf loop", _loop),
    Ailment("tf to itself", _transforms_of("base_link", "base_link", lambda _: np.eye(4))),
    Ailment("tf jumps", _transforms_of("odom", "base_link", _shifted)),
    Ailment("tf NaN", _nan_transform),
    Ailment("tf of no name", _transforms_of("", "", lambda _: np.eye(4))),
    Ailment("tf no rotation", _transforms_of("base_link", "stray", lambda _: np.zeros((4, 4)))),
    Ailment("tf absent", nothing_of(TransformsMessage), (3,), "scan_mount"),
    Ailment("several clocks", restamped(lambda t, _: t + HOUR, LaserScanMessage), (0, 3), "clocks"),
    Ailment("stamps zero", restamped(lambda *_: 0), (3,), "stamps"),
    Ailment("stamps of the laser zero", restamped(lambda *_: 0, LaserScanMessage), (3,), "clock"),
    Ailment("stamps in the future", restamped(lambda t, _: t + 10 * 365 * 24 * HOUR)),
    Ailment("stamps backwards", restamped(lambda t, n: t - 2 * SECOND * (n % 30 == 0))),
    Ailment("stamps all the same", restamped(lambda *_: 1_700_000_000 * SECOND, LaserScanMessage)),
    Ailment("clock set back", restamped(_clock_set), (0, 3), "step back"),
    Ailment("every message twice", _twice),
    Ailment("bursts", _bursts),
    Ailment("a single scan", lambda e: _first(e, LaserScanMessage), (0, 2, 3)),
    Ailment("two scans", lambda e: _first(e, LaserScanMessage, 2), (0, 2, 3)),
    Ailment("order reversed", _reversed),
)
