"""Graph files: round trips to the bit, every known kind, and clear words about broken lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from formats.graph_files import text_from_graph
from formats.graph_reading import graph_from_text, read_graph
from mapmyworld.errors import MapError

PLANAR = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0.1
VERTEX_SE2 2 2 0.5 0.2
VERTEX_XY 7 3 3
FIX 0
EDGE_SE2 0 1 1 0 0.1 10 1 0 20 0 30
EDGE_SE2 1 2 1 0.5 0.1 10 0 0 20 0 30
EDGE_SE2_XY 1 7 2 3 4 0 5
EDGE_PRIOR_SE2 2 2 0.5 0.2 1 0 0 1 0 1
"""
SPATIAL = """\
PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 3 1 2 3 0 0 0 1
VERTEX_SE3:QUAT 5 1 2 4 0 0 0.6 0.8
VERTEX_TRACKXYZ 9 1 1 1
EDGE_SE3:QUAT 3 5 0 0 1 0 0 0.6 0.8 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6
EDGE_SE3_TRACKXYZ 3 9 0 1 2 3 1 0 0 2 0 3
EDGE_SE3_PRIOR 3 0 1 2 3 0 0 0 1 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6
"""


def assert_same(a, b, tolerance=0.0):
    for name in ("ids", "map_from_node", "landmark_ids", "landmarks", "fixed_ids"):
        assert np.allclose(getattr(a, name), getattr(b, name), rtol=0, atol=tolerance)
    for part in ("edges", "sightings", "priors"):
        for name in type(getattr(a, part)).__slots__:
            left, right = getattr(getattr(a, part), name), getattr(getattr(b, part), name)
            assert np.allclose(left, right, rtol=0, atol=tolerance), (part, name)


@pytest.mark.parametrize(("text", "tolerance"), [(PLANAR, 0.0), (SPATIAL, 1e-12)])
def test_what_is_written_reads_back(text, tolerance):
    read = graph_from_text(text)
    assert read.problems == ()
    again = graph_from_text(text_from_graph(read.graph))
    assert again.problems == ()
    assert_same(read.graph, again.graph, tolerance)


def test_spatial_information_is_turned_to_rotation_first():
    edges = graph_from_text(SPATIAL).graph.edges
    assert np.diag(edges.information[0]).tolist() == [4, 5, 6, 1, 2, 3]


def test_toro_and_gtsam_lines_say_the_same_as_g2o():
    toro = graph_from_text("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 11 12 22 33 13 23\n")
    expected = [[11, 12, 13], [12, 22, 23], [13, 23, 33]]
    assert toro.graph.edges.information[0].tolist() == expected
    gtsam = graph_from_text("ODOMETRY 0 1 1 0 0 0.5 0 0 0.25 0 0.1\nLANDMARK 1 4 2 3 0.5 0 0.25\n")
    assert np.allclose(np.diag(gtsam.graph.edges.information[0]), [2, 4, 10])
    assert np.allclose(np.diag(gtsam.graph.sightings.information[0]), [2, 4])
    assert gtsam.graph.landmark_ids.tolist() == [4]


def test_a_bearing_and_range_is_written_as_a_position():
    text = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nBR 1 5 1.5707963267948966 2 0.1 0.2\n"
    again = graph_from_text(text_from_graph(graph_from_text(text).graph)).graph.sightings
    assert np.allclose(again.measured, [[0, 2]])
    # 0.1 rad at 2 m is 0.2 m across; the range's 0.2 m is along: both 25 / m^2.
    assert np.allclose(again.information[0], np.eye(2) * 25)


def test_edges_to_the_next_node_count_as_odometry():
    graph = graph_from_text(PLANAR + "EDGE_SE2 0 2 2 0.5 0.2 1 0 0 1 0 1\n").graph
    assert graph.edges.odometry.tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("EDGE_SE2 0 2 nan 0 0 1 0 0 1 0 1", "line 10: EDGE_SE2 holds a value that is not finite"),
        ("EDGE_SE2 0 2 0 0 0 1 0 0 1", "line 10: EDGE_SE2 has 9 numbers instead of 11"),
        ("EDGE_SE2 0 2 a 0 0 1 0 0 1 0 1", "line 10: EDGE_SE2: could not convert"),
        ("EDGE_SE2 0 2 0 0 0 1 2 0 1 0 1", "not positive definite (line 10)"),
        ("EDGE_SE2 0 0 0 0 0 1 0 0 1 0 1", "from a node to itself (line 10)"),
        (
            "EDGE_SE2 0 1e30 0 0 0 1 0 0 1 0 1",
            "holds an id that is no whole number",
        ),
        (
            "EDGE_SE2 0 1.5 0 0 0 1 0 0 1 0 1",
            "holds an id that is no whole number",
        ),
        ("EDGE_SE2 0 2 1e200 0 0 1 0 0 1 0 1", "line 10: EDGE_SE2 holds a value beyond 1e+100"),
        ("ODOMETRY 0 2 1 0 0 0 0 0 0 0 0", "not positive definite (line 10)"),
        ("LANDMARK 0 7 1 0 0 0 0", "not positive definite (line 10)"),
        ("BR 0 7 1 1 0 0", "not positive definite (line 10)"),
        ("VERTEX_SE2 1 5 5 5", "id that was taken (line 10)"),
        ("EDGE_WHEEL 0 1 2", "1 lines of unknown kind 'EDGE_WHEEL' (line 10)"),
        ("FIX 99", "FIX of unknown nodes 99"),
        ("FIX 1.5", "FIX takes whole numbers"),
        ("FIX 0 99999999999999999999", "FIX takes whole numbers"),  # more than 64 bits
        ("EDGE_PRIOR_SE2 99 2 0.5 0.2 1 0 0 1 0 1", "priors of unknown nodes 99"),
    ],
)
def test_a_broken_line_is_named_and_the_rest_is_read(line, word):
    read = graph_from_text(PLANAR + line + "\n")
    assert [word in problem for problem in read.problems] == [True]
    assert_same(read.graph, graph_from_text(PLANAR).graph)


def test_a_quaternion_that_is_zero_is_named():
    line = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
    read = graph_from_text(SPATIAL + line + "\n")
    where = len(SPATIAL.splitlines()) + 1
    assert read.problems == (f"line {where}: EDGE_SE3:QUAT holds a quaternion that is zero",)
    assert_same(read.graph, graph_from_text(SPATIAL).graph)


def test_tabs_and_a_byte_order_mark_change_nothing():
    read = graph_from_text("\ufeff" + PLANAR.replace(" ", "\t"))
    assert read.problems == ()
    assert_same(read.graph, graph_from_text(PLANAR).graph)


def test_comments_and_offsets_of_sensors_that_no_edge_uses_change_nothing():
    text = "# by hand\nPARAMS_SE2OFFSET 0 0 0 0\n" + PLANAR.replace("\n", "  # measured\n")
    read = graph_from_text(text)
    assert read.problems == ()
    assert_same(read.graph, graph_from_text(PLANAR).graph)


def test_a_number_too_few_and_one_too_many_do_not_make_up_for_each_other():
    short, long = "EDGE_SE2 0 2 1 0 0 1 0 0 1 0", "EDGE_SE2 0 2 1 0 0 1 0 0 1 0 1 1"
    read = graph_from_text(f"{PLANAR}{short}\n{long}\n")
    assert ["10 numbers" in read.problems[0], "12 numbers" in read.problems[1]] == [True, True]
    assert_same(read.graph, graph_from_text(PLANAR).graph)


def test_a_node_without_vertex_is_reported_and_kept():
    read = graph_from_text(PLANAR + "EDGE_SE2 2 8 1 0 0 1 0 0 1 0 1\n")
    assert "1 nodes have edges but no vertex (8)" in read.problems[0]
    assert read.graph.ids.tolist() == [0, 1, 2, 8]


@pytest.mark.parametrize("text", ["", "hello\n", PLANAR + SPATIAL])
def test_a_file_that_is_no_graph_is_refused(text, tmp_path: Path):
    path = tmp_path / "x.g2o"
    path.write_text(text)
    with pytest.raises(MapError, match=r"x\.g2o"):
        read_graph(path)


def test_the_recorded_graphs_are_read_whole(data):
    sizes = {"CSAIL": (1045, 1172), "manhattan": (3500, 5453), "sphere2500": (2500, 4949)}
    for name, (nodes, edges) in sizes.items():
        read = read_graph(data / "graphs" / f"{name}.g2o")
        assert read.problems == ()
        assert (len(read.graph), len(read.graph.edges)) == (nodes, edges)
    park = read_graph(data / "graphs" / "victoria_park.txt").graph
    assert (len(park), len(park.landmark_ids), len(park.sightings)) == (6969, 151, 3640)
    assert park.edges.odometry.all()
