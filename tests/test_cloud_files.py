"""Clouds and meshes: round trips, trimesh and PCL's description beside us, and damaged files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from formats.cloud_files import read_cloud, write_cloud, write_mesh
from formats.scene_mesh import read_scene_mesh
from mapmyworld.errors import MapError
from mapmyworld.evaluation import cloud_score
from mapmyworld.types import Mesh, PointCloud

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(50, 3)).astype(np.float32)
COLOURS = RNG.integers(0, 256, (50, 3), dtype=np.uint8)
NORMALS = RNG.normal(size=(50, 3)).astype(np.float32)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("colours", [None, COLOURS])
@pytest.mark.parametrize("normals", [None, NORMALS])
def test_clouds_read_back(
    tmp_path: Path, suffix: str, colours: np.ndarray | None, normals: np.ndarray | None
) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, PointCloud(POINTS, colours, normals))
    read = read_cloud(path)
    np.testing.assert_array_equal(read.points, POINTS)
    assert (read.colours is None) == (colours is None or suffix == ".pcd")
    if read.colours is not None:
        np.testing.assert_array_equal(read.colours, COLOURS)


def test_trimesh_reads_the_same_cloud(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.ply", PointCloud(POINTS, COLOURS, NORMALS))
    read = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(read.vertices, POINTS)
    np.testing.assert_array_equal(read.colors[:, :3], COLOURS)
    raw = read.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(np.stack([raw[n] for n in ("nx", "ny", "nz")], 1), NORMALS)


def test_trimesh_reads_the_same_mesh(tmp_path: Path) -> None:
    write_mesh(tmp_path / "mesh.ply", tetrahedron())
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.faces, tetrahedron().triangles)
    np.testing.assert_array_equal(read.vertices, tetrahedron().vertices)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], COLOURS[:4])


def pcd_fields(data: bytes) -> dict[str, np.ndarray]:
    """Of a binary file, by PCL's description of the format alone."""
    head, _, body = data.partition(b"DATA binary\n")
    lines = [line.split() for line in head.decode().splitlines() if not line.startswith("#")]
    said = {words[0]: words[1:] for words in lines}
    assert said["VERSION"] == ["0.7"]
    assert set(said["COUNT"]) == {"1"}
    kinds = {"F": "f", "U": "u", "I": "i"}
    columns = zip(said["FIELDS"], said["TYPE"], said["SIZE"], strict=True)
    dtype = np.dtype([(name, f"<{kinds[kind]}{size}") for name, kind, size in columns])
    rows = np.frombuffer(body, dtype)
    (count,) = said["POINTS"]
    assert len(rows) == int(count) == int(said["WIDTH"][0]) * int(said["HEIGHT"][0])
    return {name: rows[name] for name in said["FIELDS"]}


def test_a_pcd_file_is_what_pcl_describes(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.pcd", PointCloud(POINTS, COLOURS, NORMALS))
    read = pcd_fields((tmp_path / "cloud.pcd").read_bytes())
    np.testing.assert_array_equal(np.stack([read[n] for n in "xyz"], 1), POINTS)
    normals = np.stack([read[f"normal_{n}"] for n in "xyz"], 1)
    np.testing.assert_array_equal(normals, NORMALS)
    colours = np.stack([read["rgb"] >> shift & 255 for shift in (16, 8, 0)], 1)
    np.testing.assert_array_equal(colours, COLOURS)


def tetrahedron() -> Mesh:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
    return Mesh(vertices, triangles, COLOURS[:4])


def test_meshes_read_back(tmp_path: Path) -> None:
    for mesh in (tetrahedron(), Mesh(tetrahedron().vertices, tetrahedron().triangles)):
        write_mesh(tmp_path / "mesh.ply", mesh)
        read = read_scene_mesh(tmp_path / "mesh.ply")
        np.testing.assert_array_equal(read.vertices, mesh.vertices)
        np.testing.assert_array_equal(read.triangles, mesh.triangles)
        if mesh.colours is not None:
            np.testing.assert_array_equal(read.colours, mesh.colours)


def test_an_empty_cloud_is_a_file(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.ply", PointCloud(np.zeros((0, 3), np.float32)))
    assert read_cloud(tmp_path / "cloud.ply").points.shape == (0, 3)


def test_ascii_ply_of_other_programs(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\n"
        "property double z\nproperty float intensity\nend_header\n1 2 3 0.5\n4 5 6 0.7\n"
    )
    assert read_cloud(tmp_path / "a.ply").points.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_files_cut_anywhere_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, PointCloud(POINTS, COLOURS))
    whole = path.read_bytes()
    for length in [*range(0, 400, 7), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(MapError):
            read_cloud(path)


def test_a_header_without_an_element_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\nend_header\n0 0 0\n")  # found by a fuzzer
    with pytest.raises(MapError, match="PLY header"):
        read_cloud(path)


@pytest.mark.parametrize(("suffix", "word"), [(".ply", b"element vertex"), (".pcd", b"POINTS")])
def test_more_points_than_a_number_can_count_are_refused(
    tmp_path: Path, suffix: str, word: bytes
) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, PointCloud(POINTS, COLOURS, None))
    path.write_bytes(re.sub(word + rb" \d+", word + b" " + b"6" * 50, path.read_bytes()))
    with pytest.raises(MapError):
        read_cloud(path)


def test_names_and_contents_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"\.ply or \.pcd"):
        write_cloud(tmp_path / "cloud.xyz", PointCloud(POINTS))
    with pytest.raises(MapError, match="No such file"):
        read_cloud(tmp_path / "absent.ply")
    write_mesh(tmp_path / "mesh.ply", tetrahedron())
    data = bytearray((tmp_path / "mesh.ply").read_bytes())
    data[-1] = 99  # a vertex that does not exist
    (tmp_path / "mesh.ply").write_bytes(bytes(data))
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(tmp_path / "mesh.ply")


TEXT = (
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty {0} x\nproperty float y\n"
    "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)


@pytest.mark.filterwarnings("error")
def test_numbers_that_their_type_cannot_hold_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    for row in ("1e300 2 3 4 5 6", "1 2 3 nan 5 6"):
        path.write_text(f"{TEXT.format('float')}0 0 0 1 2 3\n{row}\n")
        with pytest.raises(MapError, match="cannot hold"):
            read_cloud(path)


@pytest.mark.filterwarnings("error")
def test_points_that_lie_nowhere_are_left_out_with_their_colours(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text(f"{TEXT.format('double')}1e300 2 3 4 5 6\n1 2 3 7 8 9\n")
    assert read_cloud(path).points.tolist() == [[1, 2, 3]]
    spoilt = POINTS.copy()
    spoilt[[3, 9]] = np.nan
    write_cloud(tmp_path / "cloud.ply", PointCloud(spoilt, COLOURS, NORMALS))
    read = read_cloud(tmp_path / "cloud.ply")
    kept = np.delete(np.arange(len(POINTS)), [3, 9])
    np.testing.assert_array_equal(read.points, POINTS[kept])
    np.testing.assert_array_equal(read.colours, COLOURS[kept])
    write_cloud(tmp_path / "cloud.pcd", PointCloud(spoilt, COLOURS, NORMALS))
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.pcd").points, POINTS[kept])


@pytest.mark.filterwarnings("error")
def test_numbers_of_several_sizes_stand_side_by_side(tmp_path: Path) -> None:
    """One of them a signalling NaN, which says so when it changes its size."""
    row = np.array([(1.0, 2.0, 3.0), (1.0, 0.0, 3.0)], [("x", "<f8"), ("y", "<f4"), ("z", "<f4")])
    row["y"].view("<u4")[1] = 0x7FA00000
    head = "FIELDS x y z\nSIZE 8 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n"
    (tmp_path / "a.pcd").write_bytes(f"{head}DATA binary\n".encode() + row.tobytes())
    assert read_cloud(tmp_path / "a.pcd").points.tolist() == [[1.0, 2.0, 3.0]]


def test_meshes_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    write_mesh(path, Mesh(tetrahedron().vertices, np.zeros((0, 3), np.int32)))
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(path)
    write_mesh(path, Mesh(np.full((4, 3), np.inf, np.float32), tetrahedron().triangles))
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(path)
    write_mesh(path, tetrahedron())
    path.write_bytes(path.read_bytes().replace(b"float z", b"float q"))
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(path)


def test_an_empty_cloud_has_no_distance_from_anything() -> None:
    with pytest.raises(MapError, match="without points"):
        cloud_score(PointCloud(np.zeros((0, 3), np.float32)), tetrahedron())
