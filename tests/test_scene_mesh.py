"""A user's own world as a mesh: every format the same room, in its own colours."""

from __future__ import annotations

import re
import struct
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from glb import write_glb

from formats.scene_mesh import read_scene_mesh
from mapmyworld.errors import MapError

# A floor of two triangles and a wall of one, in metres, z up.
VERTICES = np.array([[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0], [0, 0, 2]], np.float32)
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]], np.uint16)
RED = (255, 0, 0)


def as_obj(path: Path) -> None:
    """Wavefront, with a texture that is red wherever it is looked at."""
    cv2.imwrite(str(path.with_name("red.png")), np.full((4, 4, 3), RED[::-1], np.uint8))
    path.with_name("red.mtl").write_text("newmtl red\nmap_Kd red.png\n")
    lines = ["mtllib red.mtl", "usemtl red", "vt 0.5 0.5"]
    lines += ["v {} {} {}".format(*vertex) for vertex in VERTICES]
    lines += ["f {}/1 {}/1 {}/1".format(*(triangle + 1)) for triangle in TRIANGLES]
    path.write_text("\n".join(lines) + "\n")


def as_ply(path: Path) -> None:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 5\n"
        + "".join(f"property float {axis}\n" for axis in "xyz")
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
        + "element face 3\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = [" ".join(map(str, (*vertex, *RED))) for vertex in VERTICES]
    body += [" ".join(map(str, (3, *triangle))) for triangle in TRIANGLES]
    path.write_text(head + "\n".join(body) + "\n")


def as_glb(path: Path, claimed: int = 5) -> None:
    """Binary glTF 2.0, y up as its standard says, with colours at the vertices."""
    y_up = np.stack([VERTICES[:, 0], VERTICES[:, 2], -VERTICES[:, 1]], axis=1)
    colours = np.tile(np.array([*RED, 255], np.uint8), (5, 1))
    parts = [y_up.tobytes(), colours.tobytes(), TRIANGLES.tobytes() + b"\0\0"]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}
        ],
        "buffers": [{"byteLength": starts[3]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
            for start, part in zip(starts, parts, strict=False)
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": claimed, "type": "VEC3",
             "min": y_up.min(axis=0).tolist(), "max": y_up.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5121, "count": 5, "type": "VEC4",
             "normalized": True},
            {"bufferView": 2, "componentType": 5123, "count": 9, "type": "SCALAR"},
        ],
    }  # fmt: skip
    write_glb(path, document, parts)


@pytest.mark.parametrize(("suffix", "write"), [("ply", as_ply), ("obj", as_obj), ("glb", as_glb)])
def test_every_format_gives_the_same_room_in_its_colours(
    tmp_path: Path, suffix: str, write
) -> None:
    path = tmp_path / f"room.{suffix}"
    write(path)
    mesh = read_scene_mesh(path)
    corners = mesh.vertices[mesh.triangles]
    assert np.allclose(corners, VERTICES[TRIANGLES], atol=1e-6)
    assert mesh.colours is not None
    assert (mesh.colours == RED).all()


def test_a_mesh_that_claims_more_than_it_holds_is_refused_without_memory(tmp_path: Path) -> None:
    """Found by a fuzzer: 4 GB were taken for 2 kB."""
    path = tmp_path / "room.glb"
    as_glb(path, claimed=99_999_999)
    ply = tmp_path / "room.ply"
    as_ply(ply)
    ply.write_bytes(re.sub(rb"element vertex \d+", b"element vertex 4000000000", ply.read_bytes()))
    read_scene_mesh_of(tmp_path)
    tracemalloc.start()
    for claiming in (path, ply):
        with pytest.raises(MapError, match="no triangles"):
            read_scene_mesh(claiming)
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def read_scene_mesh_of(folder: Path) -> None:
    """Imports what reads meshes, which takes memory of its own."""
    as_obj(folder / "plain.obj")
    read_scene_mesh(folder / "plain.obj")


def test_a_world_that_names_a_file_outside_its_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.gltf"
    path.write_text('{"buffers": [{"uri": "../secret.bin"}], "accessors": []}')
    with pytest.raises(MapError, match="outside its folder"):
        read_scene_mesh(path)
    path = tmp_path / "room.obj"
    as_obj(path)
    (tmp_path / "red.mtl").write_text("newmtl red\nmap_Kd ../../secret.png\n")
    with pytest.raises(MapError, match=r"secret\.png, outside its folder"):
        read_scene_mesh(path)


@pytest.mark.parametrize("name", ["red\0.mtl", "x" * 300, "ring"])
def test_a_world_that_names_what_is_no_name_is_refused(tmp_path: Path, name: str) -> None:
    """The first was found by a fuzzer."""
    (tmp_path / "ring").symlink_to(tmp_path / "ring")
    as_obj(tmp_path / "room.obj")
    text = (tmp_path / "room.obj").read_text().replace("red.mtl", name)
    (tmp_path / "room.obj").write_text(text)
    with pytest.raises(MapError, match="no name of a file"):
        read_scene_mesh(tmp_path / "room.obj")


def test_what_holds_no_triangles_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.glb"
    path.write_bytes(b"glTF" + bytes(40))
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(path)
    with pytest.raises(MapError, match="no such file"):
        read_scene_mesh(tmp_path / "absent.ply")


def test_triangles_of_corners_that_do_not_exist_are_refused(tmp_path: Path) -> None:
    """Found by a fuzzer: some of these end the process in which Open3D reads them."""
    path = tmp_path / "room.ply"
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
        + "".join(f"property float {axis}\n" for axis in "xyz")
        + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    for corner in (-1, 3, 1 << 30):
        face = struct.pack("<B3i", 3, 0, 1, corner)
        path.write_bytes(head.encode() + VERTICES[:3].tobytes() + face)
        with pytest.raises(MapError, match="no triangles"):
            read_scene_mesh(path)


@pytest.mark.parametrize("point", ["0", "0 1"])
def test_a_world_of_points_without_three_coordinates_is_refused(tmp_path: Path, point: str) -> None:
    """Found by the campaign: the plan of its walls ended in a traceback."""
    path = tmp_path / "room.obj"
    path.write_text(f"v {point}\n" * 3 + "f 1 2 3\n")
    with pytest.raises(MapError, match="no triangles"):
        read_scene_mesh(path)


def test_a_world_larger_than_any_drive_is_refused(tmp_path: Path) -> None:
    """Found by the campaign: the plan of its walls took all memory."""
    as_ply(tmp_path / "room.ply")
    text = (tmp_path / "room.ply").read_text().replace("4.0 3.0 0.0", "1e30 3.0 0.0")
    (tmp_path / "room.ply").write_text(text)
    with pytest.raises(MapError, match="reaches beyond 10000 m"):
        read_scene_mesh(tmp_path / "room.ply")
