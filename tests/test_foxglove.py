"""`export mcap`: what Foxglove needs is there, decodes by its schemas, and hangs together."""

from __future__ import annotations

import importlib
import json
import zlib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from database_samples import fill
from mcap.reader import make_reader
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
    """Log time, topic, schema and the message; Foxglove's are decoded by its own classes."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            decoded: Any = message.data
            if schema.encoding == "protobuf":
                name = schema.name.removeprefix("foxglove.")
                module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
                decoded = getattr(module, name).FromString(message.data)
            yield message.log_time, channel.topic, schema, decoded


def stamp(value: Any) -> int:
    return int(value.timestamp.seconds) * 1_000_000_000 + int(value.timestamp.nanos)


def doctor(path: Path) -> None:
    """What `mcap doctor` asks: checksums, an index that is true, statistics that add up."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        counts: dict[int, int] = defaultdict(int)
        last = 0
        for schema, channel, message in reader.iter_messages():
            counts[channel.id] += 1
            assert message.log_time >= last
            last = message.log_time
            assert channel.schema_id == (schema.id if schema else 0)
        assert summary.statistics is not None
        assert dict(summary.statistics.channel_message_counts) == dict(counts)
        assert summary.statistics.message_count == sum(counts.values())
        for index in summary.chunk_indexes:
            assert index.message_start_time <= index.message_end_time
    data = path.read_bytes()
    assert data[:8] == data[-8:] == b"\x89MCAP0\r\n"
    footer = data[-8 - 20 - 9 :]  # opcode, length, then starts of summary and offsets, checksum
    start = int.from_bytes(footer[9:17], "little")
    crc = int.from_bytes(footer[25:29], "little")
    assert crc == zlib.crc32(data[start : len(data) - 8 - 4])


def transforms_of(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Child -> (header stamp, parent) of every transform, Foxglove's and ROS's."""
    found: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for _, _, schema, message in messages(path):
        if schema.name == "foxglove.FrameTransform":
            found[message.child_frame_id].append((stamp(message), message.parent_frame_id))
    log = open_log([path])
    for raw in log.messages():
        if raw.kind == "transforms" and not raw.topic.startswith("/map/"):
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
    doctor(tmp_path / "a.mcap")
    topics = {topic for _, topic, _, _ in messages(tmp_path / "a.mcap")}
    assert {"/tf", "/map/grid", "/map/path", "/map/graph", "/map/pose"} <= topics
    run(small, "-o", tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_the_graph_tells_its_facts(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    (scene,) = (m for _, topic, _, m in messages(tmp_path / "a.mcap") if topic == "/map/graph")
    facts = {e.id: {pair.key: pair.value for pair in e.metadata} for e in scene.entities}
    assert "rejected" in facts
    assert any("9 inliers of at least 25" in text for text in facts["rejected"].values())
    for entity in scene.entities:
        (line,) = entity.lines
        assert len(line.points) == 2 * int(facts[entity.id]["constraints"])


def test_grid_cells_stand_where_the_map_has_them(small: Path, tmp_path: Path) -> None:
    run(small, "-o", tmp_path / "a.mcap")
    (shown,) = (m for _, topic, _, m in messages(tmp_path / "a.mcap") if topic == "/map/grid")
    with open_store(small, read_only=True) as store:
        grid = store.grid()
    assert grid is not None
    cells = np.frombuffer(shown.data, np.uint8).reshape(-1, shown.column_count, 4)
    np.testing.assert_array_equal(cells[..., 0] == 25, grid.trinary() == 100)
    assert shown.cell_size.x == grid.resolution
    assert (shown.pose.position.x, shown.pose.position.y) == tuple(grid.origin)


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
    doctor(path)
    found = transforms_of(path)
    kinds = defaultdict(int)
    for time_ns, topic, _, message in messages(path):
        kinds[topic] += 1
        frame = getattr(message, "frame_id", "map") if not isinstance(message, bytes) else "map"
        assert reaches_map(frame, time_ns, found), (topic, frame)
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
    doctor(path)
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
        m
        for _, topic, _, m in messages(path)
        if topic == "/map/tf" and m.child_frame_id == "odom" and stamp(m) == frames.stamps_ns[k]
    ]
    assert near
    moved = near[0].translation
    np.testing.assert_allclose([moved.x, moved.y], expected[:2, 3], atol=1e-9)


def test_another_log_is_refused(small: Path, tmp_path: Path) -> None:
    with open_store(small) as store:
        store.put("log", {"hash": "0", "paths": ["other.bag"]})
    result = CliRunner().invoke(group, ["export", "mcap", str(small), "--with-log", str(APARTMENT)])
    assert result.exception is not None
    assert "made of another log (other.bag)" in str(result.exception)


def test_a_map_without_nodes_is_refused(tmp_path: Path) -> None:
    with open_store(tmp_path / "bare.db", create=True):
        pass
    result = CliRunner().invoke(group, ["export", "mcap", str(tmp_path / "bare.db")])
    assert "holds no nodes" in str(result.exception)
