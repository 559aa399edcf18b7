"""`mapmyworld convert`: every message arrives, bytes kept where they can be."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from log_builders import Make, drive, serialised, write_mcap, write_ros1, write_rosbag2
from test_logs_carmen import SMALL, raw_laser
from test_recording import assert_same

from cli.convert import convert
from formats.logs import open_log
from formats.logs.recorded_log import RecordedLog
from mapmyworld.types import MessageKind

ROS1, ROS2 = drive(1), drive(2)
OUTPUTS = ["a.mcap", "a.bag", "a.db3", "folder"]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(convert, [str(a) for a in arguments])


def payloads(path: Path) -> list[tuple[int, str, bytes]]:
    log = open_log([path])
    assert isinstance(log, RecordedLog)
    return [(time, channel.topic, data) for time, channel, data in log.records()]


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("ros", [1, 2])
def test_every_message_arrives_in_order(tmp_path: Path, ros: int, output: str) -> None:
    source = (
        write_ros1(tmp_path / "source.bag", ROS1, chunk_bytes=3000)
        if ros == 1
        else write_rosbag2(tmp_path / "source", ROS2)
    )
    result = run(source, "-o", tmp_path / output)
    assert result.exit_code == 0, result.output
    ours, theirs = open_log([source]), open_log([tmp_path / output])
    assert theirs.info().message_count == len(ROS1)
    for a, b in zip(ours.messages(), theirs.messages(), strict=True):
        assert (a.topic, a.log_time_ns, a.stamp_ns) == (b.topic, b.log_time_ns, b.stamp_ns)
        assert_same(a.decode(), b.decode())


@pytest.mark.parametrize(
    ("ros", "output"), [(1, "a.mcap"), (1, "a.bag"), (2, "a.mcap"), (2, "a.db3"), (2, "folder")]
)
def test_bytes_are_kept_where_the_encoding_stays(tmp_path: Path, ros: int, output: str) -> None:
    built = ROS1 if ros == 1 else ROS2
    source = (
        write_ros1(tmp_path / "s.bag", built)
        if ros == 1
        else write_mcap(tmp_path / "s.mcap", built)
    )
    assert run(source, "-o", tmp_path / output).exit_code == 0
    expected = [(b[2], b[0], serialised(ros, b)) for b in built]
    assert payloads(tmp_path / output) == expected


def test_there_and_back_gives_the_same_bytes_but_for_sequence_numbers(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "a.mcap", ROS2)
    assert run(source, "-o", tmp_path / "b.bag").exit_code == 0
    assert run(tmp_path / "b.bag", "-o", tmp_path / "c.db3").exit_code == 0
    assert payloads(tmp_path / "c.db3") == payloads(source)


@pytest.mark.parametrize("output", OUTPUTS)
def test_carmen_logs_become_the_same_messages(tmp_path: Path, output: str) -> None:
    source = tmp_path / "a.clf"
    source.write_text(SMALL)
    result = run(source, "-o", tmp_path / output)
    assert result.exit_code == 0, result.output
    ours, theirs = open_log([source]), open_log([tmp_path / output])
    for a, b in zip(ours.messages(), theirs.messages(), strict=True):
        assert (a.topic, a.kind, a.log_time_ns, a.stamp_ns) == (
            b.topic, b.kind, b.log_time_ns, b.stamp_ns,
        )  # fmt: skip
        assert_same(a.decode(), b.decode())


def test_a_selection_of_time_and_topics(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "a.mcap", ROS2)
    output = tmp_path / "b.mcap"
    result = run(source, "-o", output, "--start", 0.1, "--duration", 0.1, "--topic", "/scan")
    assert result.exit_code == 0
    times = [m.log_time_ns for m in open_log([output]).messages()]
    assert times == [10**18 + i * 10_000_000 for i in range(10, 20)]
    assert {t.topic for t in open_log([output]).info().topics} == {"/scan"}


def test_what_had_to_be_assumed_of_a_topic_that_is_written_is_a_loss(tmp_path: Path) -> None:
    """Else the new log states it as a fact, and nobody can know."""
    source = tmp_path / "a.log"
    source.write_text(raw_laser("10.5") + "ODOM 1 0 0 0 0 0 11.0 host 0.9\n")
    result = run(source, "-o", tmp_path / "a.mcap")
    assert result.exit_code == 3
    assert "the robot's centre is assumed" in result.stderr
    odometry = run(source, "-o", tmp_path / "b.mcap", "--topic", "/carmen/odom")
    assert (odometry.exit_code, odometry.stderr.count("centre")) == (0, 0)


def test_what_is_fixed_is_kept_from_before_the_part_that_is_wanted(tmp_path: Path) -> None:
    """tf_static is recorded once, at the start; without it nobody knows where a sensor sits."""
    make, source = Make(2), tmp_path / "a.mcap"
    fixed = (
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        10**18,
        make.transforms(0, [("base", "laser")]),
    )
    scans = [
        ("/scan", "sensor_msgs/msg/LaserScan", 10**18 + k * 10**8, make.scan(10**18 + k * 10**8))
        for k in range(10)
    ]
    write_mcap(source, [fixed, *scans])
    for output in ("b.mcap", "b.bag"):
        assert run(source, "-o", tmp_path / output, "--start", 0.5).exit_code == 0
        found = [(m.topic, m.log_time_ns) for m in open_log([tmp_path / output]).messages()]
        times = [10**18 + k * 10**8 for k in range(5, 10)]
        assert found == [("/tf_static", times[0]), *(("/scan", t) for t in times)]
    late = run(source, "-o", tmp_path / "c.mcap", "--start", 5)
    assert "nothing to write" in str(late.exception)
    assert not (tmp_path / "c.mcap").exists()


def test_two_parts_become_one_log(tmp_path: Path) -> None:
    middle = next(i for i in range(50, 60) if ROS1[i][2] != ROS1[i - 1][2])
    parts = [
        write_ros1(tmp_path / "1.bag", ROS1[:middle]),
        write_ros1(tmp_path / "2.bag", ROS1[middle:]),
    ]
    assert run(*parts, "-o", tmp_path / "c.bag").exit_code == 0
    assert [(t, n) for t, n, _ in payloads(tmp_path / "c.bag")] == [(b[2], b[0]) for b in ROS1]


def test_a_damaged_log_is_converted_as_far_as_it_goes_with_exit_code_3(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "a.mcap", ROS2, chunk_bytes=4000)
    source.write_bytes(source.read_bytes()[:6000])
    result = run(source, "-o", tmp_path / "b.bag")
    assert result.exit_code == 3
    assert "the file ends within the chunk" in result.output
    assert 0 < open_log([tmp_path / "b.bag"]).info().message_count < len(ROS2)


def test_messages_that_the_output_cannot_hold_are_counted(tmp_path: Path) -> None:
    from mcap.writer import Writer

    source = tmp_path / "a.mcap"
    with source.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.Log", "jsonschema", b"{}")
        channel = writer.register_channel("/log", "json", schema)
        schema = writer.register_schema("foxglove.LaserScan", "jsonschema", b"{}")
        scans = writer.register_channel("/scan", "json", schema)
        for i in range(3):
            writer.add_message(channel, i, b'{"message": "hello"}', i)
            data = b'{"timestamp": {"sec": 1, "nsec": 2}, "frame_id": "l", "ranges": [1, 2]}'
            writer.add_message(scans, i, data, i)
        writer.finish()
    result = run(source, "-o", tmp_path / "b.bag")
    assert result.exit_code == 3
    assert "/log" in result.output
    assert "3 message(s)" in result.output
    kinds = [m.kind for m in open_log([tmp_path / "b.bag"]).messages()]
    assert kinds == [MessageKind.LASER_SCAN] * 3
    assert run(source, "-o", tmp_path / "c.mcap").exit_code == 0  # which holds any encoding
    assert payloads(tmp_path / "c.mcap") == payloads(source)


def test_a_type_nobody_knows_is_converted_by_its_own_definition(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer as Ros1Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    own = get_typestore(Stores.ROS1_NOETIC)
    own.register(get_types_from_msg("std_msgs/Header header\nfloat64 left\n", "my_msgs/msg/Bump"))
    with Ros1Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/bump", "my_msgs/msg/Bump", typestore=own)
        bump = own.types["my_msgs/msg/Bump"](Make(1).header(5), 0.5)
        writer.write(connection, 7, own.serialize_ros1(bump, "my_msgs/msg/Bump"))
    assert run(tmp_path / "a.bag", "-o", tmp_path / "b").exit_code == 0
    assert run(tmp_path / "b", "-o", tmp_path / "c.bag").exit_code == 0
    (first,), (last,) = payloads(tmp_path / "a.bag"), payloads(tmp_path / "c.bag")
    assert first[:2] == last[:2]
    assert first[2][4:] == last[2][4:]  # but for the header's sequence number


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none.bag", "-o", "b.mcap"], "no such file"),
        (["a.mcap", "-o", "a.mcap"], "is read by this command"),
        (["a.mcap", "-o", "b.bag", "--topic", "/nope"], "no topic /nope"),
        (["a.mcap", "-o", "b.bag", "--start", "99"], "nothing to write"),
        (["a.mcap", "-o", "b.bag", "--compress", "zstd"], "choose none, lz4, bz2"),
        (["a.mcap", "-o", "taken.bag"], "exists already"),
    ],
)
def test_what_cannot_be_done_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_mcap(tmp_path / "a.mcap", ROS2)
    (tmp_path / "taken.bag").write_text("precious")
    result = run(*arguments)
    assert says in str(result.exception)
    assert not (tmp_path / "b.bag").exists()


@pytest.mark.slow
@pytest.mark.real_log
@pytest.mark.parametrize("name", ["neato_middle", "neato_with_particle_filter", "tf_example"])
def test_real_bags_convert_to_rosbag2(tmp_path: Path, data: Path, name: str) -> None:
    source = data / "bags" / f"{name}.bag"
    assert run(source, "-o", tmp_path / "a").exit_code == 0
    for a, b in zip(
        open_log([source]).messages(), open_log([tmp_path / "a"]).messages(), strict=True
    ):
        assert (a.topic, a.kind, a.log_time_ns, a.stamp_ns) == (
            b.topic, b.kind, b.log_time_ns, b.stamp_ns,
        )  # fmt: skip
        if a.kind is not MessageKind.OTHER:
            assert_same(a.decode(), b.decode())


@pytest.mark.slow
@pytest.mark.real_log
def test_a_real_carmen_log_is_the_same_in_bags(tmp_path: Path, data: Path) -> None:
    source = data / "laser" / "mit-csail.clf.bz2"
    expected = [(m, m.decode()) for m in islice(open_log([source]).messages(), 601)]
    for output in ("a.mcap", "a.bag"):
        assert run(source, "-o", tmp_path / output, "--duration", 66).exit_code == 0
        found = open_log([tmp_path / output]).messages()
        for (a, message), b in zip(expected, islice(found, 601), strict=True):
            assert (a.topic, a.log_time_ns, a.stamp_ns) == (b.topic, b.log_time_ns, b.stamp_ns)
            assert_same(message, b.decode())


@pytest.mark.real_log
def test_a_tum_folder_becomes_a_recording(tmp_path: Path, data: Path) -> None:
    source = data / "rgbd" / "freiburg1_rpy_15hz"
    output = tmp_path / "a.mcap"
    assert run(source, "-o", output, "--start", 4, "--duration", 0.3).exit_code == 0
    theirs = list(open_log([output]).messages())
    start = theirs[0].log_time_ns
    ours = [m for m in open_log([source]).messages() if m.log_time_ns >= start]
    for a, b in zip(ours, theirs, strict=False):
        assert (a.topic, a.kind, a.stamp_ns) == (b.topic, b.kind, b.stamp_ns)
        if a.kind is MessageKind.IMAGE:
            left, right = a.decode(), b.decode()
            np.testing.assert_array_equal(left.pixels(), right.pixels())  # type: ignore[union-attr]
