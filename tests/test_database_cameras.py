"""Cameras of RTAB-Map's databases: stereo pairs, several side by side."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from foreign_database import add_nodes, insert, mono, rtabmap_file, stereo
from numpy.typing import NDArray
from rtabmap_decoder import rvl_words

from formats.database import open_store
from formats.database.image_blobs import decode_picture, encode_depth, encode_picture
from formats.database.log_source import open_database_log


def test_a_pair_without_a_baseline_has_no_depth(tmp_path: Path) -> None:
    """What stands in the depth column of a stereo node is the right image."""
    grey = np.full((48, 64), 90, np.uint8)
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        jpeg = encode_picture(grey, "jpeg", 90)
        insert(sqlite, "Data", id=1, image=jpeg, depth=jpeg, calibration=stereo())
    with open_store(tmp_path / "r.db") as store:
        (image,) = store.node_data(1).images
    assert image.depth is None
    assert image.colour is not None
    assert image.colour.pixels().shape == (48, 64)
    assert image.colour.encoding == "mono8"


@pytest.mark.parametrize("colour", [False, True])
def test_a_stereo_pair_gives_depth(tmp_path: Path, colour: bool) -> None:
    """A wall of random texture, 12 pixels apart in both images: Z = f b / d = 60 * 0.2 / 12."""
    shift, rng = 12, np.random.default_rng(5)
    texture = rng.integers(0, 255, (96, 160 + shift, 3) if colour else (96, 160 + shift), np.uint8)
    left, right = texture[:, :160], texture[:, shift:]
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        files = [encode_picture(np.ascontiguousarray(image), "png", 0) for image in (left, right)]
        pair = stereo(160, 96, baseline=0.2)
        insert(sqlite, "Data", id=1, image=files[0], depth=files[1], calibration=pair)
    with open_store(tmp_path / "r.db") as store:
        (image,) = store.node_data(1).images
    assert image.depth is not None
    depth = np.asarray(image.depth.pixels())
    assert depth.shape == (96, 160)
    # Left of the widest disparity searched there is nothing to compare with.
    assert np.median(depth[:, 40:]) == pytest.approx(1.0, abs=0.01)
    assert np.mean(depth[:, 40:] > 0) > 0.8
    raw = {m.topic: m for m in open_database_log(tmp_path / "r.db").messages()}
    assert "/camera/depth/image" in raw


def rvl_file(metres: NDArray[np.float32]) -> bytes:
    size = struct.pack("<2I", metres.shape[1], metres.shape[0])
    return b"DEPTHRVL" + size + rvl_words((1000 * metres).astype(np.uint16))


@pytest.mark.parametrize("codec", ["rvl", "png", "float"])
def test_two_cameras_side_by_side_with_smaller_depth(tmp_path: Path, codec: str) -> None:
    colour = np.zeros((48, 128, 3), np.uint8)
    colour[:, 64:] = 200
    depth = np.full((24, 64), 1.25, np.float32)
    depth[:, 32:] = 2.5
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        insert(
            sqlite,
            "Data",
            id=1,
            image=encode_picture(colour, "png", 0),
            depth=rvl_file(depth) if codec == "rvl" else encode_depth(depth, codec),
            calibration=mono() + mono(fx=70.0),
        )
    with open_store(tmp_path / "r.db") as store:
        left, right = store.node_data(1).images
    assert left.camera.intrinsics[0, 0] == 60
    assert right.camera.intrinsics[0, 0] == 70
    for image, brightness, metres in ((left, 0, 1.25), (right, 200, 2.5)):
        assert image.colour is not None
        assert image.depth is not None
        assert (image.colour.pixels() == brightness).all()
        assert image.colour.pixels().shape == (48, 64, 3)
        np.testing.assert_allclose(image.depth.pixels(), np.full((24, 32), metres))


def test_the_picture_of_two_cameras_is_decoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def counted(data: bytes, what: str) -> NDArray[np.uint8]:
        asked.append(what)
        return decode_picture(data, what)

    monkeypatch.setattr("formats.database.image_blobs.decode_picture", counted)
    colour = np.arange(48 * 128 * 3, dtype=np.uint8).reshape(48, 128, 3)
    with rtabmap_file(tmp_path / "r.db") as sqlite:
        add_nodes(sqlite, 1)
        picture = encode_picture(colour, "png", 0)
        insert(sqlite, "Data", id=1, image=picture, calibration=mono() + mono())
    with open_store(tmp_path / "r.db") as store:
        images = store.node_data(1).images
    assert asked == []
    seen = [image.colour.pixels() for image in images if image.colour is not None]
    np.testing.assert_array_equal(np.concatenate(seen, axis=1), colour)
    assert len(asked) == 1
