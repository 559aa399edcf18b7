"""Grid files by map_server's rules, and hostile ones."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from formats.grid_files import read_grid, same_grid, write_grid
from mapmyworld.errors import MapError
from mapmyworld.types import OccupancyGrid

CELLS = np.array([[-4.0, 4.0, np.nan], [0.0, -0.5, 4.0]], np.float32)


def sample() -> OccupancyGrid:
    """Row 0 is the lowest y: free, occupied, unknown; above it two uncertain ones, occupied."""
    return OccupancyGrid(CELLS, 0.05, np.array([-1.25, 3.5]))


def test_trinary_is_what_map_saver_writes(tmp_path: Path) -> None:
    image, description = write_grid(tmp_path / "map", sample())
    assert image.read_bytes() == b"P5\n# CREATOR: mapmyworld 0.050 m/pix\n3 2\n255\n" + bytes(
        [205, 205, 0, 254, 0, 205]  # the top line is the highest y
    )
    assert description.read_text() == (
        "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.25, 3.5, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def test_a_robot_loads_the_cells_that_we_hold(tmp_path: Path) -> None:
    """map_server's own arithmetic: p = (255 - v) / 255; 205 must not fall under free_thresh."""
    _, description = write_grid(tmp_path / "map", sample())
    grey = cv2.imread(str(tmp_path / "map.pgm"), cv2.IMREAD_UNCHANGED)[::-1]
    p = (255.0 - grey) / 255.0
    loaded = np.where(p >= 0.65, 100, np.where(p <= 0.196, 0, -1))
    np.testing.assert_array_equal(loaded, sample().trinary())
    np.testing.assert_array_equal(read_grid(description).trinary(), sample().trinary())


@given(
    arrays(
        np.float32,
        st.tuples(st.integers(1, 12), st.integers(1, 12)),
        elements=st.one_of(st.floats(-5, 5, width=32), st.just(float("nan"))),
    ),
    st.floats(0.001, 1.0),
    st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
@settings(max_examples=50)
def test_every_mode_reads_back(
    tmp_path_factory: pytest.TempPathFactory,
    log_odds: np.ndarray,
    resolution: float,
    origin: tuple[float, float],
) -> None:
    grid = OccupancyGrid(log_odds, resolution, np.array(origin))
    stem = tmp_path_factory.mktemp("grid") / "map"
    for mode in ("trinary", "scale", "raw"):
        _, description = write_grid(stem, grid, mode)
        read = read_grid(description)
        assert same_grid(description, grid, mode) == 0
        assert read.resolution == resolution
        assert read.origin.tolist() == list(origin)
        if mode != "trinary":
            np.testing.assert_array_equal(np.isnan(read.log_odds), np.isnan(log_odds))


def test_verification_finds_a_changed_cell(tmp_path: Path) -> None:
    image, description = write_grid(tmp_path / "map", sample())
    data = bytearray(image.read_bytes())
    data[-1] = 0
    image.write_bytes(bytes(data))
    assert same_grid(description, sample(), "trinary") == 1


def test_foreign_yaml_with_defaults_comments_and_negation(tmp_path: Path) -> None:
    """As older map_savers wrote it: no mode, and an image whose light cells are walls."""
    cv2.imwrite(str(tmp_path / "floor.png"), np.array([[255, 0, 100]], np.uint8))
    (tmp_path / "floor.yaml").write_text(
        "# a map\nimage: floor.png\nresolution: 0.1\norigin: [1.0, 2.0, 0.0]  # corner\n"
        "negate: 1\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    assert read_grid(tmp_path / "floor.yaml").trinary().tolist() == [[100, 0, -1]]


def test_a_list_may_have_a_line_for_each_value(tmp_path: Path) -> None:
    """As PyYAML writes it, and so every script that changes a map."""
    _, description = write_grid(tmp_path / "map", sample())
    listed = "origin:\n- -1.25  # x\n  - 3.5\n- 0.0\n"
    text = description.read_text().replace("origin: [-1.25, 3.5, 0.0]\n", listed)
    description.write_text("---\n" + text)
    assert read_grid(description).origin.tolist() == [-1.25, 3.5]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("resolution: 0.05\n", "", "lacks resolution"),
        ("resolution: 0.05", "resolution: fast", "not a number"),
        ("resolution: 0.05", "resolution: -1", "not a positive"),
        ("resolution: 0.05", "resolution: nan", "finite"),
        ("origin: [-1.25, 3.5, 0.0]", "origin: [1, 2]", "is not"),
        ("origin: [-1.25, 3.5, 0.0]", "origin: [1, 2, 0.5]", "turned"),
        ("mode: trinary", "mode: best", "none of"),
        ("image: map.pgm", "image: other.pgm", "other.pgm"),
    ],
)
def test_descriptions_that_cannot_be_used(tmp_path: Path, old: str, new: str, words: str) -> None:
    _, description = write_grid(tmp_path / "map", sample())
    description.write_text(description.read_text().replace(old, new))
    with pytest.raises(MapError, match=words):
        read_grid(description)


@pytest.mark.parametrize(
    "image",
    [
        b"",
        b"P5\n3",
        b"P5\n3 2\n65535\n" + bytes(12),
        b"P5\n3 2\n255\n" + bytes(5),
        b"P5\n99999999 99999999\n255\n",
        b"P5\n" + b"9" * 5000 + b" 2\n255\n",
        b"GIF89a",
    ],
)
def test_images_that_cannot_be_used(tmp_path: Path, image: bytes) -> None:
    path, description = write_grid(tmp_path / "map", sample())
    path.write_bytes(image)
    with pytest.raises(MapError):
        read_grid(description)


def test_a_picture_that_claims_more_than_it_can_hold_is_refused_unopened(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.zeros((20, 30), np.float32), 0.05, np.zeros(2))
    picture, yaml = write_grid(tmp_path / "map", grid, "scale")
    data = bytearray(picture.read_bytes())
    data[16:24] = (15_000).to_bytes(4, "big") * 2  # width and height in the header
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    picture.write_bytes(data)
    with pytest.raises(MapError, match="15000 x 15000 cells"):
        read_grid(yaml)
