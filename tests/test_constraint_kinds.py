"""A kind of constraint that nobody drew before: stored, drawn and listed, and never a KeyError."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest

from formats.constraint_kinds import COLOURS, PATH, REJECTED
from formats.database import links
from formats.report.map_pictures import write_graph_picture
from mapmyworld.types import CLOSURES, OF_ONE_NODE, TRUSTED, ConstraintKind, Judged, Poses


def test_every_kind_that_joins_places_is_drawn() -> None:
    assert set(ConstraintKind) - set(COLOURS) == OF_ONE_NODE


def test_the_reports_page_has_the_colours_of_all_other_pictures() -> None:
    sheet = resources.files("formats.report").joinpath("assets/report.css").read_text("utf-8")
    for name, colour in {
        "path": PATH,
        "rejected": REJECTED,
        "loop": COLOURS[ConstraintKind.LOOP_CLOSURE],
        "proximity": COLOURS[ConstraintKind.PROXIMITY],
        "user": COLOURS[ConstraintKind.USER],
        "landmark": COLOURS[ConstraintKind.LANDMARK],
    }.items():
        assert f"--{name}: {colour};" in sheet


def test_no_kind_is_both_beyond_doubt_and_a_closure() -> None:
    assert not TRUSTED & CLOSURES


@dataclass(frozen=True)
class _Kind:
    """Stands for a member of `ConstraintKind` that the tables do not name."""

    value: str = "wall_parallel"


def _constraint(kind: object) -> Judged:
    return Judged(1, 2, kind, np.eye(4), np.eye(6))  # type: ignore[arg-type]


def test_the_store_writes_a_link_for_a_kind_that_rtabmap_has_no_number_for() -> None:
    forward, backward = links.link_rows([_constraint(_Kind())])
    assert forward[:3] == (1, 2, 5)
    assert backward[:3] == (2, 1, 5)


def test_a_kind_of_one_node_is_stored_once_as_rtabmaps_prior(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compass = _Kind("heading")
    monkeypatch.setattr(links, "OF_ONE_NODE", OF_ONE_NODE | {compass})
    monkeypatch.setattr(links, "_ONE_WAY", links._ONE_WAY | {compass})
    (row,) = links.link_rows([replace(_constraint(compass), to_id=1)])
    assert row[:3] == (1, 1, 7)


def test_the_picture_of_a_graph_draws_every_kind_that_joins_places(tmp_path: Path) -> None:
    poses = Poses(np.array([1, 2]), np.tile(np.eye(4), (2, 1, 1)))
    poses.map_from_node[1, 1, 3] = 3.0
    for kind, colour in COLOURS.items():
        write_graph_picture(tmp_path / "a.png", poses, [_constraint(kind)])
        picture = cv2.imread(str(tmp_path / "a.png"))
        assert picture is not None
        drawn = np.array([*bytes.fromhex(colour[1:])])
        off = np.abs(picture[..., ::-1].astype(int) - drawn).max(axis=-1)
        assert (off < 40).sum() > 100, kind  # the line and its row in the legend
