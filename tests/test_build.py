"""The whole way from a log to a map, through the command line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import log_builders
import numpy as np
import pytest
from click.testing import CliRunner, Result
from messages_in_memory import image_at
from robust.trials import wait_for_tables
from room_drive import START_NS, Drive, drive, write

from cli.main import group
from formats.database import open_store
from formats.grid_files import read_grid, same_grid
from formats.trajectory_files import read_trajectory
from mapmyworld.errors import MapMyWorldError
from mapmyworld.geometry.planar import matrix_to_planar, planar_to_matrix
from mapmyworld.geometry.rigid import between
from mapmyworld.types import LaserScanMessage, Message


def run(*arguments: object) -> Result:
    return CliRunner().invoke(group, [str(a) for a in arguments])


def build(log: object, folder: Path, *more: object) -> dict[str, Any]:
    folder.mkdir(exist_ok=True)
    found = run("build", log, "-o", folder / "map.db", "--format", "json", "-q", *more)
    assert found.exit_code in (0, 3), found.output + repr(found.exception)
    return dict(json.loads(found.stdout))


def refusal(*arguments: object) -> str:
    """The one message of a command that must refuse its input."""
    found = run(*arguments)
    assert isinstance(found.exception, MapMyWorldError), repr(found.exception)
    return str(found.exception)


def nodes_in(path: Path) -> int:
    """As another program sees them while a build goes on."""
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
        return int(database.execute("SELECT count(*) FROM Node").fetchone()[0])


@pytest.fixture(scope="module")
def room() -> Drive:
    return drive()


@pytest.fixture(scope="module")
def built(room: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room as MCAP and the map of it."""
    folder = tmp_path_factory.mktemp("room")
    room.write(folder / "room.mcap")
    summary = build(folder / "room.mcap", folder)
    assert summary["losses"] == []
    return folder


def test_the_path_is_right_to_two_centimetres_where_odometry_is_off_by_decimetres(
    built: Path, room: Drive
) -> None:
    poses = matrix_to_planar(read_trajectory(built / "map.tum").poses)
    truth = planar_to_matrix(room.truth)
    wanted = matrix_to_planar(between(truth[0], truth))
    moved = matrix_to_planar(between(planar_to_matrix(poses[0]), planar_to_matrix(poses)))
    error = np.hypot(*(moved - wanted)[:, :2].T)
    assert len(poses) == len(truth)
    assert error.max() < 0.02
    with open_store(built / "map.db", read_only=True) as store:
        last = matrix_to_planar(store.nodes()[-1].odom_from_base)
    assert np.hypot(*(last - wanted[-1])[:2]) > 0.1


def test_the_grid_read_back_by_map_servers_rules_is_the_grid_we_hold(built: Path) -> None:
    with open_store(built / "map.db", read_only=True) as store:
        grid = store.grid()
    assert grid is not None
    assert same_grid(built / "map.yaml", grid, "trinary") == 0
    cells = read_grid(built / "map.yaml").trinary()
    assert np.array_equal(cells, grid.trinary())
    # 24 m2, less 0.6 of pillars, 0.5 of half the walls' cells, and some shadow behind pillars.
    assert (cells == 0).sum() * 0.05**2 == pytest.approx(22.4, abs=0.8)


def test_walls_are_single(built: Path) -> None:
    """The room's 20 m of wall and 5 m of pillar are about one cell thick."""
    cells = read_grid(built / "map.yaml").trinary()
    assert (cells == 100).sum() * 0.05 < 1.6 * (20.0 + 4.7)


@pytest.mark.parametrize("name", ["room.bag", "room.db3", "folder"])
def test_any_container_gives_the_same_map_byte_for_byte(
    built: Path, room: Drive, tmp_path: Path, name: str
) -> None:
    room.write(tmp_path / name)
    build(tmp_path / name, tmp_path / "out")
    for product in ("map.pgm", "map.yaml", "map.tum"):
        assert (tmp_path / "out" / product).read_bytes() == (built / product).read_bytes()


def test_the_same_command_twice_gives_the_same_bytes_with_one_thread_and_with_two(
    built: Path, tmp_path: Path
) -> None:
    for threads in (1, 2):
        folder = tmp_path / str(threads)
        build(built / "room.mcap", folder, "--set", f"threads={threads}")
        for product in ("map.db", "map.pgm", "map.yaml", "map.tum"):
            assert (folder / product).read_bytes() == (built / product).read_bytes(), product


def test_all_files_have_the_name_of_the_map_also_one_with_dots(built: Path, tmp_path: Path) -> None:
    run("build", built / "room.mcap", "-o", tmp_path / "monday.hall.db", "-q")
    endings = ["db", "html", "pgm", "timing.json", "tum", "yaml"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"monday.hall.{e}" for e in endings]


def test_another_resolution_redoes_only_the_last_stage(built: Path, tmp_path: Path) -> None:
    log = built / "room.mcap"
    build(log, tmp_path)
    again = build(log, tmp_path, "--set", "mapping.resolution=0.1")
    assert again["reused_stages"] == ["plan", "track", "recognise", "optimise"]
    assert read_grid(tmp_path / "map.yaml").resolution == 0.1


@pytest.mark.slow
@pytest.mark.parametrize("is_tracked", [False, True])
def test_a_killed_build_leaves_a_readable_map_and_is_taken_up_again(
    tmp_path: Path, is_tracked: bool
) -> None:
    drive(600).write(tmp_path / "long.mcap")
    command = [sys.executable, "-m", "cli.main", "build", str(tmp_path / "long.mcap")]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "map.db")], stderr=subprocess.DEVNULL, text=True
    )
    wait_for_tables(tmp_path / "map.db", process)
    while is_tracked and process.poll() is None and not nodes_in(tmp_path / "map.db"):
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=60)
    if is_tracked:
        assert run("inspect", "map", tmp_path / "map.db").exit_code == 0
    else:
        assert "did not get that far" in refusal("inspect", "map", tmp_path / "map.db")
    build(tmp_path / "long.mcap", tmp_path)
    build(tmp_path / "long.mcap", tmp_path / "whole")
    assert (tmp_path / "map.tum").read_bytes() == (tmp_path / "whole" / "map.tum").read_bytes()


def test_dry_run_prints_the_plan_and_writes_nothing(built: Path, tmp_path: Path) -> None:
    found = run("build", built / "room.mcap", "-o", tmp_path / "x.db", "--dry-run")
    assert found.exit_code == 0
    assert "/scan" in found.stdout
    assert not (tmp_path / "x.db").exists()


def test_a_map_of_another_log_is_replaced_only_when_asked(built: Path, tmp_path: Path) -> None:
    drive(30).write(tmp_path / "other.mcap")
    build(tmp_path / "other.mcap", tmp_path)
    message = refusal("build", built / "room.mcap", "-o", tmp_path / "map.db")
    assert "--overwrite" in message
    build(built / "room.mcap", tmp_path, "--overwrite")


def test_inspect_log_names_topics_plan_and_diagnosis(built: Path) -> None:
    text = run("inspect", "log", built / "room.mcap").stdout
    assert "/scan" in text
    assert "sensor_msgs/msg/LaserScan" in text
    assert "header stamps" in text
    facts = json.loads(run("inspect", "log", built / "room.mcap", "--format", "json").stdout)
    assert facts["plan"]["base_frame"] == "base_link"


def test_inspect_log_indicates_rates_by_messages_not_by_chunks(tmp_path: Path) -> None:
    """One chunk holds all: what spoke at 20 Hz in the first second had 1 Hz of its 20 s."""
    entries = list(log_builders.drive(2, count=400, step_ns=50_000_000))
    early = [e for e in entries if e[0] != "/scan" or e[2] < entries[0][2] + 1_000_000_000]
    early = [e for e in early if e[0] != "/chatter" or e[2] < entries[0][2] + 2_000_000_000]
    log_builders.write_mcap(tmp_path / "log.mcap", early)
    result = run("inspect", "log", tmp_path / "log.mcap", "--quick", "--format", "json")
    rates = {t["topic"]: t["frequency_hz"] for t in json.loads(result.stdout)["log"]["topics"]}
    assert rates["/scan"] == pytest.approx(20.0, rel=0.01)
    assert rates["/chatter"] == pytest.approx(5.0, rel=0.01)  # a type that nobody knows


def test_inspect_map_and_node_answer_in_text_and_json(built: Path) -> None:
    facts = json.loads(run("inspect", "map", built / "map.db", "--format", "json").stdout)
    assert facts["length_m"] == pytest.approx(6.3, abs=0.3)
    node = json.loads(run("inspect", "node", built / "map.db", "3", "--format", "json").stdout)
    assert {c["with"] for c in node["constraints"]} >= {2, 4}
    assert "there is no node 9999" in refusal("inspect", "node", built / "map.db", "9999")


# Bad input: one clear message and exit code 2, or a map and an account of what is missing.


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    assert "empty" in refusal("build", tmp_path / "empty.mcap", "-o", tmp_path / "map.db")
    assert not (tmp_path / "map.db").exists()


def test_text_named_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("this is no log\n" * 50)
    assert "notes.mcap" in refusal("build", tmp_path / "notes.mcap", "-o", tmp_path / "map.db")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "nowhere.bag" in refusal("build", tmp_path / "nowhere.bag")


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
def test_a_log_cut_anywhere_still_gives_a_map_with_an_account(
    room: Drive, tmp_path: Path, suffix: str, share: float
) -> None:
    whole = tmp_path / f"whole{suffix}"
    room.write(whole)
    data = whole.read_bytes()
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(data[: int(len(data) * share)])
    found = run("build", cut, "-o", tmp_path / "map.db", "-q")
    if isinstance(found.exception, MapMyWorldError):  # cut within the only chunk
        assert "cut" in str(found.exception)
        return
    assert found.exit_code == 3, repr(found.exception)
    assert read_grid(tmp_path / "map.yaml").trinary().size > 0
    assert "partial map" in found.stderr


def test_without_scans_and_depth_there_is_no_map(room: Drive, tmp_path: Path) -> None:
    room.without("/scan").write(tmp_path / "log.mcap")
    message = refusal("build", tmp_path / "log.mcap", "-o", tmp_path / "map.db")
    assert "no laser scan topic" in message
    assert [file.name for file in tmp_path.iterdir()] == ["log.mcap"]


def test_a_map_without_nodes_is_no_map_to_look_at(tmp_path: Path) -> None:
    """As a build leaves it that was killed before it had a node."""
    open_store(tmp_path / "map.db", create=True).close()
    assert "holds no nodes" in refusal("inspect", "map", tmp_path / "map.db")


def test_a_map_stays_where_another_log_fails(built: Path, tmp_path: Path) -> None:
    shutil.copy(built / "map.db", tmp_path / "map.db")
    drive(30).write(tmp_path / "other.mcap")
    refusal("build", tmp_path / "other.mcap", "-o", tmp_path / "map.db")
    assert (tmp_path / "map.db").read_bytes() == (built / "map.db").read_bytes()


def test_without_odometry_the_laser_finds_the_way(room: Drive, tmp_path: Path) -> None:
    room.without("/odom").write(tmp_path / "log.mcap")
    build(tmp_path / "log.mcap", tmp_path)
    poses = matrix_to_planar(read_trajectory(tmp_path / "map.tum").poses)
    assert np.hypot(*(poses[-1] - poses[0])[:2]) < 0.03


def test_without_tf_the_map_is_partial_and_says_so(room: Drive, tmp_path: Path) -> None:
    room.without("/tf_static").write(tmp_path / "log.mcap")
    summary = build(tmp_path / "log.mcap", tmp_path)
    assert "sensing.scan_mount" in "\n".join(summary["losses"])
    found = run("build", tmp_path / "log.mcap", "-o", tmp_path / "map.db", "-q")
    assert found.exit_code == 3
    assert run("build", tmp_path / "log.mcap", "--dry-run").exit_code == 3
    assert run("inspect", "log", tmp_path / "log.mcap", "--quick").exit_code == 3


def test_a_robot_that_stands_still_is_reported_to(room: Drive, tmp_path: Path) -> None:
    """Ten times the sweep and the odometry of the drive's first moment."""
    topics = ("/scan", "/odom")
    first = {topic: next(e for e in room.entries if e[0] == topic) for topic in topics}
    entries = [e for e in room.entries if e[0] not in topics]
    for k in range(10):
        for topic, message, at_ns in first.values():
            later = replace(message, stamp_ns=message.stamp_ns + k * 10**8)  # type: ignore[type-var]
            entries.append((topic, later, at_ns + k * 10**8))
    write(tmp_path / "log.mcap", entries)
    found = run("build", tmp_path / "log.mcap", "-o", tmp_path / "map.db")
    assert found.exit_code == 0
    assert "the robot stood still" in found.stderr


def test_a_laser_that_hangs_upside_down_unsaid_makes_the_map_partial(
    room: Drive, tmp_path: Path
) -> None:
    """Its map is a mirror image, as sound in itself as the right one; only the wheels know."""

    def mirrored(message: Message) -> Message:
        assert isinstance(message, LaserScanMessage)
        return replace(message, ranges=np.ascontiguousarray(message.ranges[::-1]))

    room.changed("/scan", mirrored).write(tmp_path / "log.mcap")
    lost = build(tmp_path / "log.mcap", tmp_path)["losses"]
    assert len(lost) == 1
    assert "the map may be mirrored" in lost[0]
    assert "sensing.scan_mount (roll 3.14159)" in lost[0]


def test_ranges_that_are_nan_leave_the_rest(room: Drive, tmp_path: Path) -> None:
    def spoil(message: object) -> object:
        assert isinstance(message, LaserScanMessage)
        ranges = message.ranges.copy()
        ranges[::7] = np.nan
        return replace(message, ranges=ranges)

    room.changed("/scan", spoil).write(tmp_path / "log.mcap")  # type: ignore[arg-type]
    assert build(tmp_path / "log.mcap", tmp_path)["losses"] == []


def test_scans_of_nothing_but_nan_are_refused(room: Drive, tmp_path: Path) -> None:
    def blind(message: object) -> object:
        assert isinstance(message, LaserScanMessage)
        return replace(message, ranges=np.full_like(message.ranges, np.nan))

    room.changed("/scan", blind).write(tmp_path / "log.mcap")  # type: ignore[arg-type]
    message = refusal("build", tmp_path / "log.mcap", "-o", tmp_path / "map.db")
    assert "no range in the log is usable" in message


def test_time_that_runs_backwards_is_survived(room: Drive, tmp_path: Path) -> None:
    """From the middle on, every header stamp is an hour earlier, as after a clock was set."""
    hour = 3_600_000_000_000

    def late(message: Any) -> Any:
        if message.stamp_ns < START_NS + 4_000_000_000:
            return message
        return replace(message, stamp_ns=message.stamp_ns - hour)

    room.changed("/scan", late).changed("/odom", late).write(tmp_path / "log.mcap")
    build(tmp_path / "log.mcap", tmp_path)
    assert "step back" in run("inspect", "log", tmp_path / "log.mcap").stdout


def test_a_camera_without_camera_info_is_left_out_and_reported(room: Drive, tmp_path: Path) -> None:
    entries = list(room.entries)
    for i in range(10):
        time_ns = START_NS + i * 100_000_000
        entries.append(("/rgb/image", image_at(time_ns, "rgb8"), time_ns))
        entries.append(("/depth/image", image_at(time_ns, "16UC1"), time_ns))
    entries.sort(key=lambda entry: entry[2])
    write(tmp_path / "log.mcap", entries)
    summary = build(tmp_path / "log.mcap", tmp_path)
    assert "camera_info" in "\n".join(summary["losses"])


def test_unknown_settings_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    message = refusal("build", tmp_path / "no.mcap", "--set", "mapping.resolutoin=0.1")
    assert "did you mean mapping.resolution?" in message
