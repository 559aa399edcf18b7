"""`localise`, `merge` and `build --append` through the command line, and the files they write."""

from __future__ import annotations

import csv
import hashlib
import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from room_drive import Drive, drive, write

from cli.main import group
from formats.database import open_store
from formats.localisation_files import CSV_COLUMNS
from formats.logs import open_log
from formats.trajectory_files import read_trajectory
from mapmyworld.errors import MapMyWorldError
from mapmyworld.geometry.planar import between_planar, matrix_to_planar, planar_to_matrix
from mapmyworld.types import LaserScanMessage, PoseMessage, TransformsMessage


def run(*arguments: object) -> Result:
    return CliRunner().invoke(group, [str(a) for a in arguments])


def later(made: Drive, seconds: int, first: int = 0) -> Drive:
    """The same kind of drive at another time, begun some scans on."""
    shift = seconds * 1_000_000_000
    moved = []
    for topic, message, time in made.entries:
        if topic != "/tf_static" and time < made.entries[0][2] + first * 100_000_000:
            continue
        if hasattr(message, "stamp_ns") and not isinstance(message, TransformsMessage):
            message = replace(message, stamp_ns=message.stamp_ns + shift)
        moved.append((topic, message, time + shift))
    return Drive(tuple(moved), made.truth[first:])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of the room, a second drive in it, and one in a room of another shape."""
    folder = tmp_path_factory.mktemp("rooms")
    drive(seed=1).write(folder / "one.mcap")
    later(drive(seed=2), 100, first=25).write(folder / "two.mcap")
    other = drive(seed=3).changed("/scan", _narrowed)
    later(other, 200).write(folder / "other.mcap")
    for name in ("one", "two", "other"):
        made = run(
            "build", folder / f"{name}.mcap", "-o", folder / f"{name}.db", "--no-export", "-q"
        )
        assert made.exit_code == 0, made.output
    return folder


def _narrowed(message: object) -> LaserScanMessage:
    """What a laser sees where a wall stands at arm's length all round, wavy."""
    assert isinstance(message, LaserScanMessage)
    count = len(message.ranges)
    ranges = 0.9 + 0.3 * np.sin(np.arange(count) * 0.21) + 0.1 * np.sin(np.arange(count) * 0.83)
    return replace(message, ranges=ranges.astype(np.float32))


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_log_is_localised_and_the_map_is_left_alone(folder: Path, tmp_path: Path) -> None:
    before = digest(folder / "one.db")
    files = [tmp_path / f"path{ending}" for ending in (".tum", ".csv", ".mcap", ".png")]
    options = [word for file in files for word in ("-o", file)]
    found = run(
        "localise", folder / "one.db", folder / "two.mcap", *options, "--format", "json", "-q"
    )
    assert found.exit_code == 0, found.output
    assert digest(folder / "one.db") == before
    summary = json.loads(found.stdout)
    assert summary["recognised_after_s"] < 5.0
    assert summary["known_share"] == 1.0
    assert all(file.exists() for file in files)

    path = read_trajectory(files[0])
    truth = drive(seed=2).truth[25:]
    start = drive(seed=1).truth[0]  # the map begins where its drive did
    expected = between_planar(start, truth)
    off = np.hypot(*(matrix_to_planar(path.poses) - expected)[:, :2].T)
    assert len(path.stamps_ns) == len(truth)
    assert np.median(off) < 0.03
    assert off.max() < 0.1


def test_what_is_missing_of_a_cut_log_is_reported_once(folder: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((folder / "two.mcap").read_bytes()[:-8])
    found = run("localise", folder / "one.db", cut, "-o", tmp_path / "path.tum")
    assert found.exit_code == 3, found.output
    assert found.stderr.count("the recording was not closed") == 1


def test_the_csv_indicates_state_pose_and_correction(folder: Path, tmp_path: Path) -> None:
    run("localise", folder / "one.db", folder / "two.mcap", "-o", tmp_path / "path.csv", "-q")
    with (tmp_path / "path.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == CSV_COLUMNS
    states = [row["state"] for row in rows]
    assert states[0] == "recognised"
    assert states[-1] in ("tracking", "recognised")
    assert all(float(row["sigma_x"]) > 0 for row in rows)
    assert all(0.0 <= float(row["fit"]) <= 1.0 for row in rows)


def test_the_mcap_chains_map_odom_base_to_the_pose(folder: Path, tmp_path: Path) -> None:
    run("localise", folder / "one.db", folder / "two.mcap", "-o", tmp_path / "path.mcap", "-q")
    log = open_log([tmp_path / "path.mcap"])
    chained, posed = {}, {}
    for raw in log.messages(["/tf", "/localisation/pose"]):
        message = raw.decode()
        if isinstance(message, TransformsMessage):
            first, second = message.transforms
            assert (first.parent, second.parent) == ("map", "odom")
            chained[first.stamp_ns] = first.parent_from_child @ second.parent_from_child
        elif isinstance(message, PoseMessage):
            posed[message.stamp_ns] = message.pose
            assert np.all(np.linalg.eigvalsh(message.covariance) > 0)
    assert posed.keys() == chained.keys()
    assert np.allclose([chained[s] for s in posed], list(posed.values()), atol=1e-9)


def test_a_bare_grid_serves_as_well(folder: Path, tmp_path: Path) -> None:
    exported = run("export", "grid", folder / "one.db", "-o", tmp_path / "room")
    assert exported.exit_code == 0, exported.output
    out = tmp_path / "path.tum"
    found = run("localise", tmp_path / "room.yaml", folder / "two.mcap", "-o", out, "-q")
    assert found.exit_code == 0, found.output
    expected = between_planar(drive(seed=1).truth[0], drive(seed=2).truth[25:])
    off = np.hypot(*(matrix_to_planar(read_trajectory(out).poses) - expected)[:, :2].T)
    assert np.median(off) < 0.05


def test_a_place_that_is_not_in_the_map_is_reported(folder: Path, tmp_path: Path) -> None:
    found = run(
        "localise", folder / "one.db", folder / "other.mcap", "-o", tmp_path / "p.tum", "-q"
    )
    assert found.exit_code == 3
    assert "The pose is unknown for 100.0% of the scans" in found.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["localise", "absent.db", "{two}", "-o", "p.tum"], "no such map"),
        (["localise", "{one}", "absent.mcap", "-o", "p.tum"], "absent.mcap"),
        (["merge", "{one}", "absent.db", "-o", "m.db"], "absent.db"),
        (["merge", "{one}", "{one}", "-o", "m.db"], "with itself"),
    ],
)
def test_what_cannot_be_used_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    named = [a.format(one=folder / "one.db", two=folder / "two.mcap") for a in arguments]
    found = run(*named)
    assert isinstance(found.exception, MapMyWorldError)
    assert text in str(found.exception)
    assert list(tmp_path.iterdir()) == []


def test_sessions_of_one_room_merge_in_any_order(folder: Path, tmp_path: Path) -> None:
    one, two = folder / "one.db", folder / "two.db"
    before = digest(one), digest(two)
    for name, maps in (("ab", (one, two)), ("ba", (two, one))):
        made = run("merge", *maps, "-o", tmp_path / f"{name}.db", "-q", "--no-export")
        assert made.exit_code == 0, made.output
    assert digest(tmp_path / "ab.db") == digest(tmp_path / "ba.db")
    assert (digest(one), digest(two)) == before
    with open_store(tmp_path / "ab.db", read_only=True) as store:
        nodes, solved = store.nodes(), store.poses()
        assert [node.session for node in nodes] == sorted(node.session for node in nodes)
        assert {node.session for node in nodes} == {0, 1}
        assert solved is not None
        session_of = {node.id: node.session for node in nodes}
        across = [c for c in store.constraints() if session_of[c.from_id] != session_of[c.to_id]]
        assert sum(c.accepted for c in across) >= 3
        frames, poses = store.tracked_frames(), store.frame_poses()
        assert poses is not None
        assert len(poses) == 80 + 55
    truth = np.concatenate([drive(seed=1).truth, drive(seed=2).truth[25:]])
    off = matrix_to_planar(poses) - between_planar(drive(seed=1).truth[0], truth)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.03
    assert len(frames.stamps_ns) == len(truth)
    parts = [facts(path) for path in (one, two)]
    for name in ("duration_s", "length_m"):  # without what lies between the sessions
        total = sum(part[name] for part in parts)
        assert facts(tmp_path / "ab.db")[name] == pytest.approx(total, rel=0.01)


def facts(path: Path) -> dict[str, float]:
    return dict(json.loads(run("inspect", "map", path, "--format", "json").stdout))


def test_sessions_of_different_rooms_are_kept_apart(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "both.db"
    made = run("merge", folder / "one.db", folder / "other.db", "-o", out, "--format", "json", "-q")
    assert made.exit_code == 3
    assert "nothing connects" in made.stderr
    summary = json.loads(made.stdout)
    assert [Path(entry["file"]).name for entry in summary["maps"]] == ["both.db", "both_2.db"]
    for entry in summary["maps"]:
        with open_store(Path(entry["file"]), read_only=True) as store:
            assert store.grid() is not None
            assert len({node.session for node in store.nodes()}) == 1


def test_logs_are_appended_to_a_map(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.db"
    logs = [folder / "one.mcap", folder / "two.mcap"]
    for log in logs:
        made = run("build", "--append", out, log, "-q", "--no-export")
        assert made.exit_code == 0, made.output
    once = tmp_path / "once.db"
    made = run("build", "--append", once, *reversed(logs), "-q", "--no-export")
    assert made.exit_code == 0, made.output
    with open_store(out, read_only=True) as a, open_store(once, read_only=True) as b:
        pair = [store.poses() for store in (a, b)]
        assert len(a.nodes()) == len(b.nodes())
    assert pair[0] is not None
    assert pair[1] is not None
    assert np.allclose(pair[0].map_from_node, pair[1].map_from_node, atol=0.01)
    assert {p.name for p in tmp_path.iterdir()} == {"map.db", "once.db"}


def test_what_stands_beside_a_map_is_of_that_map(folder: Path, tmp_path: Path) -> None:
    """The report, the cloud and the timing of before stood beside an extended map."""
    out = tmp_path / "map.db"
    assert run("build", folder / "one.mcap", "-o", out, "-q").exit_code == 0
    (tmp_path / "map.ply").write_text("of a map with a camera")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    reported = run("build", "--append", out, folder / "two.mcap", "--no-export")
    assert "map.ply" in reported.stderr
    assert "of the map before" in reported.stderr
    shutil.copy(folder / "one.db", out)
    done = run("build", "--append", out, folder / "two.mcap", "-q", "--format", "json")
    written = {Path(name).name for name in json.loads(done.stdout)["files"]}
    assert {path.name for path in tmp_path.iterdir()} == written | {"map.timing.json"}
    assert "map.ply" not in written
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    changed = {name for name in after if after[name] != before[name]}
    assert changed >= {"map.db", "map.tum", "map.html", "map.timing.json"}
    assert "<dt>sessions</dt><dd>2</dd>" in after["map.html"].decode()
    stages = [stage["name"] for stage in json.loads(after["map.timing.json"])["stages"]]
    assert "join sessions" in stages


def test_a_log_of_another_room_leaves_the_map_as_it_was(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.db"
    assert run("build", "--append", out, folder / "one.mcap", "-q", "--no-export").exit_code == 0
    with open_store(out, read_only=True) as store:
        before = len(store.nodes())
    made = run("build", "--append", out, folder / "other.mcap", "-q", "--no-export")
    assert made.exit_code == 3
    with open_store(out, read_only=True) as store:
        assert len(store.nodes()) == before
    before_2 = (tmp_path / "map_2.db").read_bytes()
    again = run("build", "--append", out, folder / "other.mcap", "-q", "--no-export")
    assert str(tmp_path / "map_3.db") in again.stdout
    assert (tmp_path / "map_2.db").read_bytes() == before_2
    assert (tmp_path / "map_3.db").exists()


def test_append_goes_with_no_other_way_to_build(folder: Path) -> None:
    found = run("build", "--append", "map.db", "--overwrite", folder / "one.mcap")
    assert found.exit_code == 2
    assert "--append" in found.output


def test_an_unfinished_map_is_not_merged(folder: Path, tmp_path: Path) -> None:
    with open_store(tmp_path / "empty.db", create=True):
        pass
    found = run("merge", folder / "one.db", tmp_path / "empty.db", "-o", tmp_path / "m.db", "-q")
    assert "not finished" in str(found.exception)
    assert not (tmp_path / "m.db").exists()


def test_several_logs_can_be_written_by_the_writer(tmp_path: Path) -> None:
    """The drive's own writer, so that a fault of this file's fixtures shows here."""
    made = later(drive(scans=10), 5)
    write(tmp_path / "short.mcap", made.entries)
    assert open_log([tmp_path / "short.mcap"]).info().message_count == len(made.entries)


def test_other_programs_read_the_outputs(folder: Path, tmp_path: Path) -> None:
    """Evo the trajectory; rosbags the poses with their covariance, the states and tf."""
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D
    from evo.tools import file_interface
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    files = [tmp_path / f"path.{ending}" for ending in ("tum", "csv", "mcap")]
    options = [word for file in files for word in ("-o", file)]
    run("localise", folder / "one.db", folder / "two.mcap", *options, "-q")
    with files[1].open() as stream:
        rows = {int(row["stamp_ns"]): row for row in csv.DictReader(stream)}

    expected = between_planar(drive(seed=1).truth[0], drive(seed=2).truth[25:])
    truth = PoseTrajectory3D(
        poses_se3=list(planar_to_matrix(expected)), timestamps=np.array(sorted(rows)) * 1e-9
    )
    found = file_interface.read_tum_trajectory_file(str(files[0]))
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data(sync.associate_trajectories(truth, found, max_diff=0.001))
    assert error.get_statistic(metrics.StatisticsType.median) < 0.03

    reported: dict[str, list[object]] = {}
    with AnyReader([files[2]], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            reported.setdefault(connection.topic, []).append(message)
    assert set(reported) == {"/tf", "/localisation/pose", "/localisation/state"}
    changes = [state for state, _ in itertools.groupby(row["state"] for row in rows.values())]
    assert [message.data for message in reported["/localisation/state"]] == changes  # type: ignore[attr-defined]
    for message in reported["/localisation/pose"]:
        row = rows[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec]  # type: ignore[attr-defined]
        pose = message.pose.pose.position  # type: ignore[attr-defined]
        assert (pose.x, pose.y) == pytest.approx((float(row["x"]), float(row["y"])), abs=1e-8)
        covariance = message.pose.covariance.reshape(6, 6)  # type: ignore[attr-defined]
        own = np.hypot(float(row["sigma_x"]), float(row["sigma_y"]))
        assert np.sqrt(np.trace(covariance[:2, :2])) == pytest.approx(own, rel=1e-4)
        assert np.sqrt(covariance[5, 5]) == pytest.approx(float(row["sigma_yaw"]), rel=1e-4)
    frames = {(t.header.frame_id, t.child_frame_id) for m in reported["/tf"] for t in m.transforms}  # type: ignore[attr-defined]
    assert frames == {("map", "odom"), ("odom", "base_link")}
