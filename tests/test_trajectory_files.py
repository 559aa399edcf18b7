"""Trajectory files: exact stamps, evo as a second reader, and malformed lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formats.trajectory_files import CSV_HEADER, read_trajectory, write_trajectory
from formats.truth_files import read_loop_pairs
from mapmyworld.errors import MapError
from mapmyworld.geometry.rigid import se3_exp
from mapmyworld.types import Trajectory


def sample(count: int = 20, first_ns: int = 1_305_031_229_528_748_123) -> Trajectory:
    motions = np.random.default_rng(0).normal(size=(count, 6)) * [1, 1, 1, 50, 50, 5]
    return Trajectory(first_ns + np.arange(count) * 33_333_333, se3_exp(motions))


@given(st.lists(st.integers(-(1 << 62), 1 << 62), min_size=1, max_size=5))
@settings(max_examples=50)
def test_stamps_are_exact_to_the_nanosecond(
    tmp_path_factory: pytest.TempPathFactory, stamps: list[int]
) -> None:
    path = tmp_path_factory.mktemp("t") / "t"
    poses = np.stack([np.eye(4)] * len(stamps))
    poses[:, 0, 3] = np.arange(len(stamps))
    trajectory = Trajectory(np.array(stamps), poses)
    for style in ("tum", "csv"):
        write_trajectory(path, trajectory, style)
        read = read_trajectory(path)
        assert read.stamps_ns.tolist() == sorted(set(stamps))  # each once, as their readers demand
        places = [stamps.index(stamp) for stamp in read.stamps_ns.tolist()]
        assert read.poses[:, 0, 3].tolist() == places


@pytest.mark.parametrize("style", ["tum", "kitti", "csv"])
def test_poses_read_back(tmp_path: Path, style: str) -> None:
    write_trajectory(tmp_path / "t", sample(), style)
    read = read_trajectory(tmp_path / "t")
    np.testing.assert_allclose(read.poses, sample().poses, rtol=0, atol=2e-9)
    expected = np.arange(20) * 10**9 if style == "kitti" else sample().stamps_ns
    np.testing.assert_array_equal(read.stamps_ns, expected)


def test_evo_reads_the_same(tmp_path: Path) -> None:
    tools = pytest.importorskip("evo.tools.file_interface")
    write_trajectory(tmp_path / "t.tum", sample(first_ns=5 * 10**9), "tum")
    theirs = tools.read_tum_trajectory_file(str(tmp_path / "t.tum"))
    np.testing.assert_allclose(np.stack(theirs.poses_se3), sample().poses, rtol=0, atol=3e-9)
    write_trajectory(tmp_path / "t.kitti", sample(), "kitti")
    theirs = tools.read_kitti_poses_file(str(tmp_path / "t.kitti"))
    np.testing.assert_allclose(np.stack(theirs.poses_se3), sample().poses, rtol=0, atol=1e-9)


def test_tum_lines_are_as_evo_wants_them(tmp_path: Path) -> None:
    write_trajectory(tmp_path / "t", sample(2), "tum")
    for line in (tmp_path / "t").read_text().splitlines():
        assert line == line.strip()
        assert len(line.split(" ")) == 8
        assert all(len(word.split(".")[1]) == 9 for word in line.split(" "))


def test_comments_blank_lines_and_exponents(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("# t x y z qx qy qz qw\n\n1.5e0 1 2 3 0 0 0 2\n")
    read = read_trajectory(tmp_path / "t")
    assert read.stamps_ns.tolist() == [1_500_000_000]
    np.testing.assert_array_equal(read.poses[0, :3, 3], [1, 2, 3])
    np.testing.assert_array_equal(read.poses[0, :3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3", "line 2: 3 fields"),
        ("1 0 0 0 0 0 0 1 9", "line 2: 9 fields"),
        ("noon 0 0 0 0 0 0 1", "line 2: 'noon'"),
        ("1 0 0 x 0 0 0 1", "line 2: could not convert"),
        ("1 0 0 nan 0 0 0 1", "line 2: a number that is not finite"),
        ("1 0 0 0 0 0 0 0", "line 2: the quaternion"),
        ("inf 0 0 0 0 0 0 1", "line 2: 'inf'"),
        ("1e300 0 0 0 0 0 0 1", "line 2: '1e300'"),
        ("1 0 0 0 1e300 0 0 1", "line 2: a number that is not finite, or out of range"),
    ],
)
def test_malformed_lines_are_named(tmp_path: Path, line: str, words: str) -> None:
    (tmp_path / "t").write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(MapError, match=words):
        read_trajectory(tmp_path / "t")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 0 0 0 0 0 0 0 0 0 0\n", "line 2: its 3 x 3 matrix is no"),
        (f"{CSV_HEADER}\n{1 << 64},0,0,0,0,0,0,1\n", "is not a time"),
    ],
)
def test_kitti_without_rotations_and_csv_beyond_all_times(
    tmp_path: Path, text: str, words: str
) -> None:
    (tmp_path / "t").write_text(text)
    with pytest.raises(MapError, match=words):
        read_trajectory(tmp_path / "t")


def test_files_without_poses(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("# nothing\n")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\0\x80")
    for name, words in (("empty", "holds no poses"), ("binary", "cannot"), ("absent", "cannot")):
        with pytest.raises(MapError, match=words):
            read_trajectory(tmp_path / name)


@pytest.mark.parametrize("line", ["1,2,3,4", f"1,{1 << 64},0,0,0", "1,2,0,nan,0", "1,2,1e300,0,0"])
def test_loop_pairs_without_sense_are_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "loop_pairs.csv"
    path.write_text(f"first_stamp_ns,second_stamp_ns,x,y,yaw\n1,2,0,0,0\n{line}\n")
    with pytest.raises(MapError, match="line 3"):
        read_loop_pairs(path)
