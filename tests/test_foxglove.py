"""`export mcap`: what Foxglove needs is there, decodes by its schemas, and hangs together."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from click.testing import CliRunner
from database_samples import fill
from mcap.reader import make_reader
from mcap_doctor import CHUNK, doctor, records
from mcap_ros2.decoder import DecoderFactory
from sample_maps import APARTMENT, apartment  # noqa: F401

from cli.main import group
from formats.database import open_store
from formats.logs import open_log
from mapmyworld.types import TransformsMessage

Message = tuple[int, str, Any, Any]


def run(*words: str | Path) -> None:
    result = CliRunner().invoke(group, ["export", "mcap", *map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output


def messages(path: Path) -> Iterator[Message]:
    """Log time, topic, schema and the message, decoded by the file alone, as a viewer does."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            yield message.log_time, channel.topic, schema, decoded


def sound(path: Path) -> None:
    """What `mcap doctor` asks, and more; log times never step back."""
    assert doctor(path.read_bytes()) == []


def transforms_of(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Child -> (header stamp, parent) of every transform, ours and the log's."""
    found: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for raw in open_log([path]).messages():
        if raw.kind == "transforms":
            message = raw.decode()
            assert isinstance(message, TransformsMessage)
            for item in message.transforms:
                time = 0 if message.static else item.stamp_ns
                found[item.child].append((time, item.parent))
    return found


def reaches_map(frame: str, time_ns: int, found: dict[str, list[tuple[int, str]]]) -> bool:
    """Whether a chain of transforms that are not younger leads from the frame to the map."""
    for _ in range(20):
        if frame == "map":
            return True
        known = [parent for time, parent in found.get(frame, ()) if time <= time_ns]
        if not known:
            return False
        assert len(set(known)) == 1, f"{frame} hangs on {set(known)}"
        frame = known[0]
    return False


@pytest.fixture
def small(tmp_path: Path) -> Path:
    with open_store(tmp_path / "map.db", create=True) as store:
        fill(store)
    return tmp_path / "map.db"


def test_a_small_map(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    sound(tmp_path / "a.mcap")
    topics = {topic for _, topic, _, _ in messages(tmp_path / "a.mcap")}
    assert {"/tf", "/map/grid", "/map/path", "/map/graph", "/map/pose"} <= topics
    run(small, "-o", tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def unpacked(data: bytes) -> tuple[bytes, ...]:
    """What stands before the one frame of zstd, in it and behind it: some bits mean nothing."""
    start, frame = data.find(b"zstd") + 12, zstandard.ZstdDecompressor().decompressobj()
    try:
        return data[:start], frame.decompress(data[start:]), frame.unused_data
    except zstandard.ZstdError:
        return (data,)


def test_the_doctor_finds_what_is_wrong(small: Path, tmp_path: Path) -> None:
    """Any flipped bit of the checked parts, any cut, and an index that points elsewhere."""
    run(small, "-o", tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    chunk = next(record for record in records(data[:-8], 8) if record.code == CHUNK)
    rng = np.random.default_rng(0)
    for at in rng.choice(np.arange(chunk.start, len(data)), 300, replace=False).tolist():
        hurt = bytearray(data)
        hurt[at] ^= 1 << int(rng.integers(8))
        if unpacked(bytes(hurt)) != unpacked(data):
            assert doctor(bytes(hurt)) != [], f"byte {at} of {len(data)}"
    for size in rng.integers(0, len(data) - 1, 50).tolist():
        assert doctor(data[:size]) != []


def test_the_graph_indicates_its_facts(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    (graph,) = (m for _, topic, _, m in messages(tmp_path / "a.mcap") if topic == "/map/graph")
    facts = {marker.ns: marker.text.splitlines() for marker in graph.markers}
    assert "rejected" in facts
    assert any("evidence 12 points, 30 needed" in text for text in facts["rejected"])
    for marker in graph.markers:
        assert f"{len(marker.points) // 2} constraints" == facts[marker.ns][0]


def test_grid_cells_stand_where_the_map_has_them(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    (shown,) = (m for _, topic, _, m in messages(tmp_path / "a.mcap") if topic == "/map/grid")
    with open_store(small, read_only=True) as store:
        grid = store.grid()
    assert grid is not None
    cells = np.array(shown.data, np.int8).reshape(shown.info.height, shown.info.width)
    np.testing.assert_array_equal(cells, grid.trinary())
    assert shown.info.resolution == np.float32(grid.resolution)
    corner = shown.info.origin.position
    assert (corner.x, corner.y) == tuple(grid.origin)


def test_the_path_has_the_pose_of_every_frame(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    (path,) = (m for _, topic, _, m in messages(tmp_path / "a.mcap") if topic == "/map/path")
    with open_store(small, read_only=True) as store:
        frames, poses = store.tracked_frames(), store.frame_poses()
    stamps = [p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in path.poses]
    places = [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in path.poses]
    assert poses is not None
    assert stamps == frames.stamps_ns.tolist()
    np.testing.assert_array_equal(places, poses[:, :3, 3])


def test_messages_are_as_the_schemas_in_the_file_say(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    seen = set()
    for _, _, schema, message in messages(tmp_path / "a.mcap"):
        seen.add(schema.name)
        assert_sound(message)
    assert {
        "nav_msgs/msg/Path",
        "nav_msgs/msg/OccupancyGrid",
        "visualization_msgs/msg/MarkerArray",
    } <= seen


def assert_sound(message: Any) -> None:
    """Unit quaternions, named frames, lines of two ends each."""
    names = set(getattr(message, "__slots__", ()))
    if names == {"x", "y", "z", "w"}:
        assert np.linalg.norm([message.x, message.y, message.z, message.w]) == pytest.approx(1)
    if "header" in names:
        assert message.header.frame_id
    if "ns" in names:
        assert len(message.points) % 2 == 0
    for name in names - {"texture"}:
        for item in value if isinstance(value := getattr(message, name), list) else [value]:
            assert_sound(item)


def test_the_layout_names_topics_that_exist(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    layout = json.loads((tmp_path / "a.layout.json").read_text())
    topics = {topic for _, topic, _, _ in messages(tmp_path / "a.mcap")}
    shown = set(layout["configById"]["3D!map"]["topics"]) - {"/map/cloud"}
    assert shown <= topics


@pytest.mark.slow
def test_every_message_of_the_apartment_hangs_on_the_map(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    path = tmp_path / "apartment.mcap"
    run(apartment, "-o", path)
    sound(path)
    found = transforms_of(path)
    kinds = defaultdict(int)
    for _, topic, _, message in messages(path):
        kinds[topic] += 1
        assert_sound(message)
    for raw in open_log([path]).messages():
        if raw.topic != "/tf" and raw.kind != "other":
            frame = raw.decode().frame_id  # type: ignore[union-attr]
            assert reaches_map(frame, raw.log_time_ns, found), (raw.topic, frame)
    assert kinds["/map/camera0/image"] > 50
    assert kinds["/map/pose"] > 100
    assert kinds["/tf"] > 500
    assert kinds["/map/cloud"] == kinds["/map/grid"] == 1


@pytest.mark.slow
def test_the_log_replays_in_the_corrected_frame(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    path = tmp_path / "replay.mcap"
    run(apartment, "-o", path, "--with-log", APARTMENT)
    sound(path)
    found, original = transforms_of(path), open_log([APARTMENT])
    there = defaultdict(int)
    for raw in open_log([path]).messages():
        there[raw.topic] += 1
        message = raw.decode() if raw.kind in {"laser_scan", "image", "imu"} else None
        if message is not None:
            assert reaches_map(message.frame_id, message.stamp_ns, found), raw.topic
    for topic in original.info().topics:
        assert there[topic.topic] >= topic.count, topic.topic
    with open_store(apartment, read_only=True) as store:
        frames, poses = store.tracked_frames(), store.frame_poses()
    assert poses is not None
    assert frames.odom_from_base is not None
    k = len(poses) // 2
    expected = poses[k] @ np.linalg.inv(frames.odom_from_base[k])
    near = [
        item.parent_from_child
        for raw in open_log([path]).messages(["/map/tf"])
        for item in raw.decode().transforms  # type: ignore[union-attr]
        if item.child == "odom" and item.stamp_ns == frames.stamps_ns[k]
    ]
    assert near
    np.testing.assert_allclose(near[0], expected, atol=1e-9)


def test_another_log_is_refused(small: Path, tmp_path: Path) -> None:
    with open_store(small) as store:
        store.put("log", {"hash": "0", "paths": ["other.bag"]})
    result = CliRunner().invoke(group, ["export", "mcap", str(small), "--with-log", str(APARTMENT)])
    assert result.exception is not None
    assert "made of another log: give other.bag" in str(result.exception)


def test_a_map_without_nodes_is_refused(tmp_path: Path) -> None:
    with open_store(tmp_path / "bare.db", create=True):
        pass
    result = CliRunner().invoke(group, ["export", "mcap", str(tmp_path / "bare.db")])
    assert "holds no nodes" in str(result.exception)
