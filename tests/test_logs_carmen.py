"""CARMEN logs: exact values, the order of the file, and damage."""

from __future__ import annotations

import bz2
import gzip
import math
import time
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_builders import allowed

from formats.decimal_stamps import stamp_from_text
from formats.logs import open_log
from formats.logs.carmen_records import flaser_angles
from formats.logs.carmen_survey import longest_return
from mapmyworld.config import SensingConfig
from mapmyworld.errors import LogError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.sensing import make_plan, survey_log
from mapmyworld.types import (
    LaserScanMessage,
    MessageKind,
    OdometryMessage,
    PoseMessage,
    RawMessage,
    TransformsMessage,
)


def flaser(ranges: list[str], pose: str, odometry: str, stamp: str, name: str = "FLASER") -> str:
    return f"{name} {len(ranges)} {' '.join(ranges)} {pose} {odometry} {stamp} host {stamp}\n"


def log_of(tmp_path: Path, text: str) -> list[RawMessage]:
    path = tmp_path / "a.log"
    path.write_text(text)
    return list(open_log([path]).messages())


HEAD = "# CARMEN Logfile\nPARAM robot_frontlaser_offset 0.1 0 host 0\n"
SMALL = HEAD + "".join(
    [
        flaser(["1.07", "81.83"], "1.1 2 0", "1.0 2 0", "10.5"),
        "ODOM 1.5 2.5 0.25 0.5 -0.125 0.0 11.0 host 0.9\n",
        flaser(["1.5", "nan"], "2.1 2 0", "2.0 2 0", "10.75"),
        "TRUEPOS 3 4 0.5 1 2 0.5 12.000000001 host 1.9\n",
    ]
)


def test_a_scan_follows_the_odometry_taken_with_it(tmp_path: Path) -> None:
    messages = log_of(tmp_path, SMALL)
    assert [(m.topic, m.stamp_ns, m.log_time_ns) for m in messages] == [
        ("/tf_static", 10_500_000_000, 10_500_000_000),
        ("/odom", 10_500_000_000, 10_500_000_000),
        ("/scan", 10_500_000_000, 10_500_000_000),
        ("/carmen/odom", 11_000_000_000, 11_000_000_000),
        ("/odom", 10_750_000_000, 11_000_000_000),  # it steps back; log time does not
        ("/scan", 10_750_000_000, 11_000_000_000),
        ("/ground_truth", 12_000_000_001, 12_000_000_001),
    ]


def test_values_are_exact(tmp_path: Path) -> None:
    messages = {}
    for message in log_of(tmp_path, SMALL):
        messages.setdefault(message.topic, message.decode())
    scan, odometry, wheels = messages["/scan"], messages["/odom"], messages["/carmen/odom"]
    assert isinstance(scan, LaserScanMessage)
    assert scan.ranges.tolist() == [np.float32("1.07"), np.float32("81.83")]
    assert scan.frame_id == "laser"
    assert isinstance(odometry, OdometryMessage)
    assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    np.testing.assert_array_equal(matrix_to_planar(odometry.pose), [1.0, 2.0, 0.0])
    assert isinstance(wheels, OdometryMessage)
    np.testing.assert_allclose(matrix_to_planar(wheels.pose), [1.5, 2.5, 0.25], atol=1e-15)
    assert wheels.twist.tolist() == [0.5, 0, 0, 0, 0, -0.125]
    truth = messages["/ground_truth"]
    assert isinstance(truth, PoseMessage)
    np.testing.assert_allclose(matrix_to_planar(truth.pose), [3, 4, 0.5], atol=1e-15)
    static = messages["/tf_static"]
    assert isinstance(static, TransformsMessage)
    assert static.static
    (mounting,) = static.transforms
    assert (mounting.parent, mounting.child) == ("base_link", "laser")
    np.testing.assert_allclose(matrix_to_planar(mounting.parent_from_child), [0.1, 0, 0])


@given(st.integers(0, 2**33 - 1), st.integers(0, 10**9 - 1), st.integers(0, 9))
def test_stamps_are_exact_nanoseconds(seconds: int, nanoseconds: int, digits: int) -> None:
    text = f"{seconds}.{nanoseconds:09d}"[: len(str(seconds)) + 1 + digits]
    assert stamp_from_text(text.encode()) == int(Decimal(text) * 10**9)


@pytest.mark.parametrize("text", ["", "host", "-1.5", "1e400", "nan", "99999999999", "1.2.3"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no time"):
        stamp_from_text(text.encode())


@pytest.mark.parametrize("text", [b"1e999999999", b"4509.e605290", b"-3e888888888"])
def test_a_stamp_beyond_all_measure_is_refused_at_once(text: bytes) -> None:
    """Found by a fuzzer: as an integer it took minutes."""
    began = time.process_time()
    with pytest.raises(ValueError, match="no time"):
        stamp_from_text(text)
    assert time.process_time() - began < 1.0


def test_a_stamp_with_an_exponent_is_read() -> None:
    assert stamp_from_text(b"1.5e3") == 1_500_000_000_000


@pytest.mark.parametrize(
    ("count", "last_deg"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0)]
)
def test_flaser_beams_span_half_a_turn(count: int, last_deg: float) -> None:
    first, step = flaser_angles(count)
    assert math.degrees(first) == -90
    assert math.degrees(first + step * (count - 1)) == pytest.approx(last_deg)


def test_robotlaser_has_angles_and_beams_of_its_own(tmp_path: Path) -> None:
    text = (
        "ROBOTLASER1 0 -1.0 2.0 1.0 30.0 0.01 1 3 1 2 3 3 7 8 9 "
        "5.2 6 0.1 5 6 0.1 0.5 0.25 0.3 0.2 1.0 100.25 host 0.1\n"
        "ROBOTLASER1 0 -0.5 1.0 0.5 40.0 0.01 0 2 4 5 0 "
        "5.2 6 0.1 5 6 0.1 0.5 0.25 0.3 0.2 1.0 100.5 host 0.2\n"
    )
    scans = [m.decode() for m in log_of(tmp_path, text) if m.kind is MessageKind.LASER_SCAN]
    assert [s.ranges.tolist() for s in scans] == [[1, 2, 3], [4, 5]]  # type: ignore[union-attr]
    first, second = scans
    assert isinstance(first, LaserScanMessage)
    assert isinstance(second, LaserScanMessage)
    assert first.intensities.tolist() == [7, 8, 9]
    assert (first.angle_min, first.angle_increment, first.range_max) == (-1.0, 1.0, 30.0)
    assert (second.angle_min, second.angle_increment, second.range_max) == (-0.5, 0.5, 40.0)
    assert len(second.intensities) == 0


def test_a_rear_laser_has_its_topic_frame_and_place(tmp_path: Path) -> None:
    text = SMALL + flaser(["1"], "-0.2 0 3.0", "0 0 0", "13.0", "RLASER")
    messages = log_of(tmp_path, text)
    static = messages[0].decode()
    assert isinstance(static, TransformsMessage)
    places = {t.child: matrix_to_planar(t.parent_from_child) for t in static.transforms}
    np.testing.assert_allclose(places["laser_rear"], [-0.2, 0, 3.0], atol=1e-12)
    (scan,) = (m.decode() for m in messages if m.topic == "/scan_rear")
    assert scan.frame_id == "laser_rear"  # type: ignore[union-attr]


def test_no_return_values_are_reported_from_long_ones(tmp_path: Path) -> None:
    """A repeated value far above all others is no return; a long wall is not."""
    lines = [
        flaser([f"{5 + i}.0", f"{6.4 + i}", "81.83"], "0 0 0", "0 0 0", f"{i}.5") for i in range(21)
    ]
    scan = next(m for m in log_of(tmp_path, "".join(lines)) if m.topic == "/scan").decode()
    assert isinstance(scan, LaserScanMessage)
    assert 26.4 < scan.range_max < 81.83
    counts = np.zeros(100, np.int64)
    counts[:40] = 100
    one = np.ones(100, bool)
    assert longest_return(counts, one) == 40
    counts[[50, 81]] = 5000  # two kinds of no return
    assert longest_return(counts, one) == 40
    assert longest_return(counts, ~one) == 82  # values that vary are returns
    counts[[50, 81]] = 1  # too rare to be one
    assert longest_return(counts, one) == 82
    assert longest_return(np.zeros(10, np.int64), one) == 0


def test_the_recorded_range_limit_is_used(tmp_path: Path) -> None:
    lines = ["PARAM robot_front_laser_max 80.5 1.0 host 1.0\n"]
    lines += [flaser(["5.0", "81.83"], "0 0 0", "0 0 0", f"{i}.5") for i in range(20)]
    scan = next(m for m in log_of(tmp_path, "".join(lines)) if m.topic == "/scan").decode()
    assert scan.range_max == 80.5  # type: ignore[union-attr]


@pytest.mark.parametrize(("none", "kept"), [("81.83", False), ("81.91", False), ("95.00", True)])
def test_a_code_is_no_return_however_far_the_laser_saw(
    tmp_path: Path, none: str, kept: bool
) -> None:
    """Returns up to 80.4 m along a corridor leave no gap below what a SICK writes for none."""
    lines = [flaser([f"{60 + i}.4", "70.02", none], "0 0 0", "0 0 0", f"{i}.5") for i in range(21)]
    scan = next(m for m in log_of(tmp_path, "".join(lines)) if m.topic == "/scan").decode()
    assert scan.range_max > 80.4  # type: ignore[union-attr]
    assert (scan.range_max > float(none)) == kept  # type: ignore[union-attr]


def test_a_corrected_log_does_not_pretend_a_mounting(tmp_path: Path) -> None:
    """Where x y theta is a corrected pose, its difference to the odometry grows: no mounting."""
    lines = [flaser(["5", "6"], f"{i} 0 0", f"{i * 0.9} {i * 0.1} 0", f"{i}.5") for i in range(50)]
    path = tmp_path / "a.gfs"
    path.write_text(HEAD + "".join(lines))
    log = open_log([path])
    static = next(log.messages({"/tf_static"})).decode()
    assert isinstance(static, TransformsMessage)
    place = matrix_to_planar(static.transforms[0].parent_from_child)
    np.testing.assert_allclose(place, [0.1, 0, 0])  # of PARAM
    ((topic, doubt),) = log.info().doubts
    assert topic == "/scan"
    assert "corrected" in doubt
    assert doubt in make_plan(survey_log(log), SensingConfig()).losses
    unused = SensingConfig(scan_topic="/scan_rear")
    rear = [flaser(["5", "6"], f"{i - 1} 0 3", f"{i} 0 3", f"{i}.6", "RLASER") for i in range(50)]
    path.write_text(HEAD + "".join([*lines, *rear]))
    assert doubt in make_plan(survey_log(open_log([path])), unused).warnings


def mounting_of(messages: list[RawMessage], frame: str) -> list[float]:
    static = messages[0].decode()
    assert isinstance(static, TransformsMessage)
    places = {t.child: matrix_to_planar(t.parent_from_child) for t in static.transforms}
    found: list[float] = places[frame].tolist()
    return found


def test_a_laser_that_looks_straight_back_keeps_its_place(tmp_path: Path) -> None:
    """Rounding puts its yaw now above pi, now below -pi: no reason to call it not constant."""
    lines = []
    for i in range(60):
        yaw = 0.1 * i
        pose = f"{i - 0.1 * math.cos(yaw):.6f} {-0.1 * math.sin(yaw):.6f} {yaw + math.pi:.6f}"
        lines.append(flaser(["5"], pose, f"{i} 0 {yaw:.6f}", f"{i}.5", "RLASER"))
    messages = log_of(tmp_path, "".join(lines))
    x, y, yaw = mounting_of(messages, "laser_rear")
    assert (x, y) == pytest.approx((-0.1, 0.0), abs=1e-5)
    assert abs(yaw) == pytest.approx(math.pi, abs=1e-5)
    assert not open_log([tmp_path / "a.log"]).info().doubts


def raw_laser(stamp: str, name: str = "RAWLASER1") -> str:
    return f"{name} 0 -0.5 1.0 0.5 40.0 0.01 0 3 1.5 2.5 3.5 1 7.0 {stamp} host {stamp}\n"


def test_raw_sweeps_serve_where_no_line_has_them_with_a_pose(tmp_path: Path) -> None:
    odom = "ODOM 1.5 2.5 0.25 0.5 -0.125 0.0 11.0 host 0.9\n"
    messages = log_of(tmp_path, HEAD + odom + raw_laser("11.5"))
    assert [m.topic for m in messages] == ["/tf_static", "/carmen/odom", "/scan"]
    scan = messages[2].decode()
    assert isinstance(scan, LaserScanMessage)
    assert scan.ranges.tolist() == [1.5, 2.5, 3.5]
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (-0.5, 0.5, 40.0)
    assert mounting_of(messages, "laser") == [0.1, 0.0, 0.0]
    log_of(tmp_path, odom + raw_laser("11.5"))
    assert "PARAM robot_frontlaser_offset" in open_log([tmp_path / "a.log"]).info().doubts[0][1]


def test_raw_sweeps_are_counted_and_left_where_others_have_the_pose(tmp_path: Path) -> None:
    messages = log_of(tmp_path, SMALL + raw_laser("13.0"))
    assert [m.topic for m in messages].count("/scan") == 2
    info = open_log([tmp_path / "a.log"]).info()
    assert info.message_count == len(messages)
    details = dict(info.details)
    assert "RAWLASER1 1" in details["lines"]
    assert "not used" in details["RAWLASER1"]


def test_a_sweep_that_ends_with_its_stamp_is_whole(tmp_path: Path) -> None:
    short = "FLASER 2 1.5 2.5 1.1 2 0 1.0 2 0 10.5\n"
    messages = log_of(tmp_path, HEAD + short)
    assert [(m.topic, m.stamp_ns) for m in messages[1:]] == [
        ("/odom", 10_500_000_000),
        ("/scan", 10_500_000_000),
    ]
    odometry, scan = (m.decode() for m in messages[1:])
    np.testing.assert_array_equal(matrix_to_planar(odometry.pose), [1, 2, 0])  # type: ignore[union-attr]
    assert scan.ranges.tolist() == [1.5, 2.5]  # type: ignore[union-attr]
    for damaged in (short[:-1], short.replace(" 10.5", "")):  # cut in its stamp; without one
        with pytest.raises(LogError, match="1 damaged line"):
            log_of(tmp_path, HEAD + damaged)


@pytest.mark.parametrize("suffix", [".log", ".clf.bz2", ".gfs.gz"])
def test_compressed_logs_are_the_same_log(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    data = SMALL.encode()
    pack = {".bz2": bz2.compress, ".gz": gzip.compress}.get(path.suffix, bytes)
    path.write_bytes(pack(data))
    info = open_log([path]).info()
    assert info.container == "CARMEN log"
    assert {t.topic: t.count for t in info.topics} == {
        "/odom": 2, "/scan": 2, "/carmen/odom": 1, "/ground_truth": 1, "/tf_static": 1,
    }  # fmt: skip
    assert info.message_count == len(list(open_log([path]).messages()))
    assert (info.start_ns, info.end_ns) == (10_500_000_000, 12_000_000_001)


def test_a_range_too_large_for_single_precision_is_no_return(tmp_path: Path) -> None:
    """Without a warning; found by Atheris."""
    line = flaser(["1.0", "1e300", "2.0"], "0 0 0", "0 0 0", "1.0")
    scan = next(m.decode() for m in log_of(tmp_path, line) if m.kind is MessageKind.LASER_SCAN)
    assert isinstance(scan, LaserScanMessage)
    assert scan.ranges.tolist() == [1.0, math.inf, 2.0]


@pytest.mark.parametrize("far", ["1e308", "-1e308"])
def test_a_laser_farther_than_anything_lies_has_no_place_on_the_robot(
    tmp_path: Path, far: str
) -> None:
    """Without a warning; found by Atheris."""
    line = flaser(["1.0", "2.0"], "0 0 0", f"{far} 0 0", "1.0")
    messages = log_of(tmp_path, f"{line}PARAM robot_frontlaser_offset {far} 1 h 1\n")
    assert mounting_of(messages, "laser") == [0.0, 0.0, 0.0]


def test_damaged_lines_are_skipped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    good = SMALL.splitlines(keepends=True)
    bad = ["FLASER 5 1 2\n", "FLASER x\n", "ODOM 1 2\n", "ODOM\n", "\xff\xfe\n"]
    path.write_text("".join(good[:3] + bad + good[3:]), encoding="latin-1")
    log = open_log([path])
    assert len(list(log.messages())) == 7
    (loss,) = log.info().problems
    assert "4 damaged line(s)" in loss
    assert "line 4" in loss


def test_a_log_cut_in_the_first_numbers_of_a_laser_line_is_read(tmp_path: Path) -> None:
    """Found by a fuzzer: its third field looked like a stamp, and its pose had two numbers."""
    path = tmp_path / "a.log"
    path.write_text(SMALL + "ROBOTLASER1 0 -1.2")
    log = open_log([path])
    assert all(raw.decode() is not None for raw in log.messages())
    assert "1 damaged line(s)" in log.info().problems[0]


@pytest.mark.parametrize("pack", [bz2.compress, gzip.compress])
def test_a_cut_compressed_log_gives_what_it_has(tmp_path: Path, pack: object) -> None:
    lines = [
        flaser([f"{1 + (i * j) % 97 / 100:.2f}" for j in range(50)], "0 0 0", "0 0 0", f"{i}.5")
        for i in range(5000)
    ]
    data = pack(("".join(lines)).encode())  # type: ignore[operator]
    path = tmp_path / ("a.log.bz2" if data[:2] == b"BZ" else "a.log.gz")
    path.write_bytes(data[: len(data) * 9 // 10])
    log = open_log([path])
    messages = list(log.messages())
    assert 2 * 2000 < len(messages) < 2 * 5000
    assert "the rest is lost" in log.info().problems[0]


@pytest.mark.parametrize("cut", range(1, len(SMALL), 7))
def test_a_log_cut_anywhere_is_read_or_refused(tmp_path: Path, cut: int) -> None:
    messages = allowed(lambda: log_of(tmp_path, SMALL[:cut]), "a.log") or []
    for message in messages:
        message.decode()
    assert len(messages) <= 7


@pytest.mark.slow
@pytest.mark.real_log
@pytest.mark.parametrize(
    ("name", "scans", "back"),
    [("intel", 13631, True), ("mit-csail", 1988, False)],
)
def test_real_logs_read_completely(data: Path, name: str, scans: int, back: bool) -> None:
    """Every line counts; stamps that step back stay where they are in the file."""
    log = open_log([data / "laser" / f"{name}.clf.bz2"])
    latest, stamps = 0, []
    for message in log.messages():
        assert message.log_time_ns >= latest
        latest = message.log_time_ns
        if message.topic == "/scan":
            assert message.stamp_ns is not None
            stamps.append(message.stamp_ns)
    assert len(stamps) == scans
    assert log.info().problems == ()
    assert bool((np.diff(stamps) < 0).any()) is back
