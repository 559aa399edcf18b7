"""The pictures that show why a pair was believed or not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from memory_store import MemoryStore
from visual_rooms import HEIGHT, WIDTH, Room, planar_pose

from formats.report.match_picture import write_features_picture, write_match_picture
from mapmyworld.config import Config
from mapmyworld.errors import MapError
from mapmyworld.places.node_pairs import NodePair, compare_nodes
from mapmyworld.types import Node, NodeData
from mapmyworld.types.wording import in_words


@pytest.fixture(scope="module")
def pair() -> NodePair:
    """Two views of one wall, 0.2 m apart."""
    store, room = MemoryStore(), Room()
    for i, pose in enumerate((planar_pose(3.0, 2.5, 0.0), planar_pose(3.1, 2.4, 0.1)), start=1):
        store.add_node(Node(i, 0, i, pose, pose), NodeData(images=(room.image(pose),)))
    return compare_nodes(store, 1, 2, Config())


def test_a_match_picture_shows_both_images_and_marks_every_match(
    pair: NodePair, tmp_path: Path
) -> None:
    found = pair.pair
    write_match_picture(
        tmp_path / "pair.svg",
        (pair.colour_a.pixels(), pair.colour_b.pixels()),
        pair.features_a.pixels[found.features_a],
        pair.features_b.pixels[found.features_b],
        found.agreed,
        in_words(found.registration.verdict),
    )
    drawn = (tmp_path / "pair.svg").read_text()
    width, height = map(float, re.findall(r'viewBox="0 0 (\S+) (\S+)"', drawn)[0])
    assert 0.8 < width / height * HEIGHT / (2 * WIDTH) < 1.1  # both, and a line of text
    agreed = int(found.agreed.sum())
    for colour, count in (("#00c850", agreed), ("#e63c32", len(found.agreed) - agreed)):
        lines = re.findall(rf'<path d="M \S+ \S+ \nL \S+ \S+ \n" .*stroke: {colour}', drawn)
        assert len(lines) == count
        rings = re.findall(rf"<use .*stroke: {colour}", drawn)
        assert len(rings) == 2 * count


def test_the_original_picture_is_not_drawn_upon(pair: NodePair, tmp_path: Path) -> None:
    picture = pair.colour_a.pixels()
    before = picture.copy()
    write_features_picture(tmp_path / "a.png", picture, pair.features_a)
    assert np.array_equal(picture, before)


def test_a_node_without_an_image_cannot_be_compared() -> None:
    store = MemoryStore()
    store.add_node(Node(1, 0, 1, np.eye(4), np.eye(4)), NodeData())
    with pytest.raises(MapError, match="no image"):
        compare_nodes(store, 1, 1, Config())
    with pytest.raises(MapError, match="no node 5"):
        compare_nodes(store, 5, 1, Config())
