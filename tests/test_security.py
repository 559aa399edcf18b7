"""What SECURITY.md promises: no code from files, no way out of their folders, bounded claims."""

from __future__ import annotations

import ast
import bz2
import os
import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from conftest import ROOT
from robust.trials import try_command

from formats.database.image_blobs import decode_picture
from formats.grid_files import read_grid, write_grid
from formats.limits import Limits, limits, set_limits
from formats.logs import open_log
from formats.logs.block_files import DamagedBlockError
from formats.logs.compression import decompress, decompress_beginning
from formats.logs.image_pixels import decode_compressed_depth, encoded_pixels
from formats.picture_files import claims_too_much, picture_size
from formats.scene_mesh import read_scene_mesh
from mapmyworld.errors import LogError, MapError
from mapmyworld.types import OccupancyGrid

_FORBIDDEN = {"pickle", "marshal", "shelve", "yaml", "dill"}


def test_no_source_runs_code_or_shells() -> None:
    for room in ("cli", "formats", "mapmyworld"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.Import | ast.ImportFrom):
                    names = {alias.name.split(".")[0] for alias in node.names}
                    module = getattr(node, "module", None) or ""
                    assert not (names | {module.split(".")[0]}) & _FORBIDDEN, path
                if isinstance(node, ast.Call):
                    name = getattr(node.func, "id", "")
                    assert name not in {"eval", "exec"}, path
                    assert not any(k.arg in {"shell", "allow_pickle"} for k in node.keywords), path


def grid(folder: Path) -> Path:
    folder.mkdir()
    cells = OccupancyGrid(np.zeros((4, 5), np.float32), 0.05, np.zeros(2))
    return write_grid(folder / "map", cells)[1]


@pytest.mark.parametrize("name", ["../secret/map.pgm", "{outside}/map.pgm", "link.pgm"])
def test_a_grid_cannot_point_outside_its_folder(tmp_path: Path, name: str) -> None:
    outside, inside = grid(tmp_path / "secret").parent, grid(tmp_path / "maps")
    (inside.parent / "link.pgm").symlink_to(outside / "map.pgm")
    text = inside.read_text("utf-8").replace("map.pgm", name.format(outside=outside))
    inside.write_text(text, "utf-8")
    with pytest.raises(MapError, match="outside its folder"):
        read_grid(inside)
    assert read_grid(outside / "map.yaml").trinary().shape == (4, 5)  # the picture is sound


def test_a_list_of_images_cannot_point_outside_its_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(b"\x89PNG")
    folder = tmp_path / "tum"
    folder.mkdir()
    (folder / "rgb.txt").write_text("1.0 ../secret.png\n")
    with pytest.raises(LogError, match="no images"):
        open_log([folder])


def test_names_from_a_manifest_become_no_paths(tmp_path: Path) -> None:
    path = tmp_path / "logs.toml"
    path.write_text('[[log]]\nname = "../../up"\nlog = "a.bag"\n')
    found = try_command(["batch", str(path), "-o", str(tmp_path / "out")])
    assert found.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_bombs_stop_at_the_limit(tmp_path: Path) -> None:
    before = limits()
    set_limits(Limits(unpacked_bytes=1 << 20))
    try:
        bomb = tmp_path / "a.log.bz2"
        bomb.write_bytes(bz2.compress(b"# CARMEN\n" + b"ODOM 0 0 0 0 0 0 1 h 1\n" * 200_000))
        with pytest.raises(LogError, match=r"limits\.unpacked_gb"):
            list(open_log([bomb]).messages())
        packed = tmp_path / "a.mcap.zstd"
        packed.write_bytes(zstandard.compress(bytes(4 << 20)))
        with pytest.raises(LogError, match=r"limits\.unpacked_gb"):
            open_log([packed]).info()
    finally:
        set_limits(before)


@pytest.mark.parametrize("kind", ["zstd", "lz4", "bz2"])
def test_a_chunk_unpacks_to_no_more_than_it_claims(kind: str) -> None:
    """Though its frame indicates, truly, that it is 64 MB."""
    plain = bytes(64 << 20)
    pack = {
        "zstd": zstandard.ZstdCompressor().compress,
        "lz4": lz4.frame.compress,
        "bz2": bz2.compress,
    }
    packed = pack[kind](plain)
    tracemalloc.start()
    with pytest.raises(DamagedBlockError, match="1000 are announced"):
        decompress(packed, kind, 1000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 << 20
    assert decompress_beginning(b"", kind, 1000) == b""  # cut where it begins, it ends as well


def test_images_of_other_kinds_reach_no_decoder() -> None:
    for data in (b"II*\0" + bytes(100), b"BM" + bytes(100), b"GIF89a" + bytes(100), b""):
        with pytest.raises(LogError, match="no JPEG, PNG or WebP"):
            encoded_pixels(data, "rgb8")


def test_the_size_of_a_webp_is_known_before_it_is_decoded() -> None:
    cv2 = pytest.importorskip("cv2")
    picture = np.random.default_rng(0).integers(0, 255, (37, 53, 3), np.uint8)
    for quality in (50, 101):  # lossy, lossless
        data = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
        assert picture_size(data) == (53, 37)


@pytest.mark.parametrize(
    "hidden",
    [b"\xff\xff\xff", b"\x00\x00", b"\xff\xd0", b"\xff\x01", b"\xff\xe0\x00\x00"],
    ids=["filled", "no marker", "restart", "bare", "too short"],
)
def test_no_jpeg_hides_its_size_from_us_alone(hidden: bytes) -> None:
    """OpenCV passes over all of these; 700 bytes would become 3 GB."""
    cv2 = pytest.importorskip("cv2")
    sound = cv2.imencode(".jpg", np.zeros((37, 53, 3), np.uint8))[1].tobytes()
    place = sound.find(b"\xff\xc0")
    data = sound[:place] + hidden + sound[place:]
    assert picture_size(data) == (53, 37)
    assert encoded_pixels(data, "rgb8").shape == (37, 53, 3)
    size = data.find(b"\xff\xc0") + 5
    huge = data[:size] + struct.pack(">2H", 16_000, 65_000) + data[size + 4 :]
    with pytest.raises(LogError, match="claims 65000 x 16000"):
        encoded_pixels(huge, "rgb8")


def test_a_jpeg_of_ten_thousand_scans_reaches_no_decoder() -> None:
    """Ten bytes each, and each visits every pixel."""
    cv2 = pytest.importorskip("cv2")
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    sound = cv2.imencode(".jpg", np.zeros((37, 53, 3), np.uint8), options)[1].tobytes()
    assert encoded_pixels(sound, "rgb8").shape == (37, 53, 3)
    last = sound.rfind(b"\xff\xda")
    many = sound[:last] + sound[last : last + 10] * 10_000 + sound[last:]
    with pytest.raises(LogError, match="cannot be decoded"):
        encoded_pixels(many, "rgb8")


def test_depth_that_is_no_png_reaches_no_decoder() -> None:
    cv2 = pytest.importorskip("cv2")
    tiff = cv2.imencode(".tiff", np.ones((4, 5), np.uint16))[1].tobytes()
    with pytest.raises(LogError, match="cannot be decoded"):
        decode_compressed_depth(bytes(12) + tiff, "16UC1", "16UC1; compressedDepth png")


def test_a_png_whose_chunk_claims_gigabytes_reaches_no_decoder(tmp_path: Path) -> None:
    """OpenCV would take the room before it reads the chunk; a sound file with text after it is."""
    cv2 = pytest.importorskip("cv2")
    cells = np.random.default_rng(0).integers(0, 255, (30, 40), np.uint8)
    sound = cv2.imencode(".png", cells)[1].tobytes()
    assert not claims_too_much(sound + b"behind the end")
    np.testing.assert_array_equal(encoded_pixels(sound, "mono8"), cells)
    claiming = sound[:33] + b"\xff\xff\xff\xff" + sound[37:]
    with pytest.raises(LogError, match="cannot be decoded"):
        encoded_pixels(claiming, "mono8")
    with pytest.raises(MapError, match="damaged image"):
        decode_picture(claiming, "node 3's image")


def test_a_pipe_where_a_file_should_be_is_refused_unopened(tmp_path: Path) -> None:
    """Opened, it would be waited for until somebody writes into it."""
    os.mkfifo(tmp_path / "log.mcap")
    for name in (tmp_path / "log.mcap", tmp_path, Path("/dev/null")):
        with pytest.raises(LogError, match="a device or a pipe"):
            open_log([name])
    inside = grid(tmp_path / "maps")
    inside.with_suffix(".pgm").unlink()
    os.mkfifo(inside.with_suffix(".pgm"))
    with pytest.raises(MapError, match="is no file"):
        read_grid(inside)
    os.mkfifo(tmp_path / "world.mtl")
    (tmp_path / "world.obj").write_text("mtllib world.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(MapError, match="is no file"):
        read_scene_mesh(tmp_path / "world.obj")
