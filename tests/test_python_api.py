"""The library as a notebook uses it."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from room_drive import drive

import mapmyworld
from mapmyworld.types import PointCloud


def names_in(stub: str) -> set[str]:
    """What a stub file promises."""
    found: set[str] = set()
    for node in ast.parse((ROOT / stub).read_text()).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found.add(node.target.id)
    return found


def test_what_is_promised_is_there() -> None:
    assert set(mapmyworld.__all__) == names_in("mapmyworld/__init__.pyi")
    for attribute in mapmyworld.__all__:
        assert getattr(mapmyworld, attribute) is not None
    with pytest.raises(AttributeError, match="nothing_of_ours"):
        _ = mapmyworld.nothing_of_ours  # type: ignore[attr-defined]


def test_importing_the_library_loads_nothing() -> None:
    code = "import mapmyworld, sys; print('numpy' in sys.modules)"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    assert out.stdout.strip() == "False"


def test_a_map_in_memory_is_that_of_a_file(tmp_path: Path) -> None:
    log = mapmyworld.MemoryLog(drive().entries)
    memory = mapmyworld.build(log)
    with mapmyworld.open_map(tmp_path / "map.db", create=True) as store:
        filed = mapmyworld.build(log, into=store)
        assert filed.result.nodes == memory.result.nodes
        ours, theirs = memory.map.poses(), store.poses()
        assert ours is not None
        assert theirs is not None
        np.testing.assert_allclose(ours.map_from_node, theirs.map_from_node, atol=1e-6)


def test_settings_are_checked() -> None:
    assert mapmyworld.configured(mapping__resolution=0.1).mapping.resolution == 0.1
    with pytest.raises(mapmyworld.MapMyWorldError, match="resolution"):
        mapmyworld.configured(mapping__resolutoin=0.1)


def test_a_path_is_all_that_building_needs(tmp_path: Path) -> None:
    """What everybody tries first; as text, as a path, or as the parts of one session."""
    log = tmp_path / "room.mcap"
    drive().write(log)
    built = mapmyworld.build(str(log))
    assert built.result.nodes == mapmyworld.build([log]).result.nodes > 5
    filed = mapmyworld.build(log, into=tmp_path / "room.db")
    filed.map.close()  # type: ignore[attr-defined]
    with mapmyworld.open_map(tmp_path / "room.db", read_only=True) as store:
        assert len(store.nodes()) == built.result.nodes
    with pytest.raises(mapmyworld.MapMyWorldError, match=r"nothing\.mcap"):
        mapmyworld.build(tmp_path / "nothing.mcap")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the room, and beside it the map in a file."""
    folder = tmp_path_factory.mktemp("room")
    drive().write(folder / "room.mcap")
    mapmyworld.build(folder / "room.mcap", into=folder / "room.db").map.close()  # type: ignore[attr-defined]
    return folder / "room.mcap"


def test_a_map_is_exported_from_memory_as_from_a_file(room: Path, tmp_path: Path) -> None:
    built = mapmyworld.build(room)
    for name, given in (("memory", built), ("file", room.with_suffix(".db"))):
        written = mapmyworld.export(given, tmp_path / f"{name}.v1")
        assert {path.name for path in written} == {
            f"{name}.v1.pgm",
            f"{name}.v1.yaml",
            f"{name}.v1.tum",
        }
    assert (tmp_path / "memory.v1.pgm").read_bytes() == (tmp_path / "file.v1.pgm").read_bytes()


def test_a_log_is_localised_in_a_map_or_a_grid(room: Path, tmp_path: Path) -> None:
    in_map = mapmyworld.localise(room.with_suffix(".db"), room)
    assert in_map.known_share > 0.9
    mapmyworld.export(room.with_suffix(".db"), tmp_path / "grid")
    in_grid = mapmyworld.localise(tmp_path / "grid.yaml", room)
    assert in_grid.known_share > 0.9
    with pytest.raises(mapmyworld.MapMyWorldError, match="no grid"):
        mapmyworld.localise(mapmyworld.MemoryMap(), room)


def test_maps_are_merged_in_memory(room: Path) -> None:
    (one,) = mapmyworld.merge(room.with_suffix(".db"), mapmyworld.build(room))
    assert one.sessions == 2
    assert one.links > 0
    assert len(one.map.nodes()) == 2 * len(
        mapmyworld.to_arrays(room.with_suffix(".db"))["node_ids"]
    )
    with pytest.raises(mapmyworld.MapMyWorldError, match="at least two"):
        mapmyworld.merge(one)


def test_a_map_is_edited_in_memory_and_in_its_file(room: Path, tmp_path: Path) -> None:
    edits, copy = tmp_path / "edits.toml", tmp_path / "map.db"
    shutil.copy(room.with_suffix(".db"), copy)
    edits.write_text('[[pin]]\nnode = 1\npose = [10.0, 0.0, 0.0]\nreason = "surveyed"\n')
    built = mapmyworld.build(room)
    assert mapmyworld.edit(built, edits) == mapmyworld.edit(copy, edits) == ()
    for given in (built, copy):
        at = mapmyworld.to_arrays(given)["map_from_node"][0, :3, 3]
        np.testing.assert_allclose(at, [10.0, 0.0, 0.0], atol=0.01)


def test_a_map_becomes_plain_arrays_and_evos_trajectory(room: Path) -> None:
    arrays = mapmyworld.to_arrays(room.with_suffix(".db"))
    assert arrays["map_from_base"].shape == (len(arrays["stamps_ns"]), 4, 4)
    assert arrays["edges"].shape == (len(arrays["accepted"]), 2)
    assert set(np.unique(arrays["grid"])) <= {-1, 0, 100}
    path = mapmyworld.to_evo(room.with_suffix(".db"))
    np.testing.assert_allclose(np.stack(path.poses_se3), arrays["map_from_base"], atol=1e-9)
    np.testing.assert_allclose(path.timestamps, arrays["stamps_ns"] * 1e-9)
    assert path.check()[0]


def test_a_cloud_becomes_open3ds(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in of the three names that are used: Open3D wants libraries of the system."""
    clouds = ModuleType("open3d")
    clouds.utility = SimpleNamespace(Vector3dVector=np.asarray)  # type: ignore[attr-defined]
    clouds.geometry = SimpleNamespace(  # type: ignore[attr-defined]
        PointCloud=lambda points: SimpleNamespace(points=points)
    )
    monkeypatch.setitem(sys.modules, "open3d", clouds)
    points = np.arange(6, dtype=np.float32).reshape(2, 3)
    colours = np.array([[255, 0, 51], [0, 0, 0]], np.uint8)
    made = mapmyworld.to_open3d(PointCloud(points, colours, points))
    np.testing.assert_array_equal(made.points, points)
    np.testing.assert_allclose(made.colors[0], [1.0, 0.0, 0.2])
    assert made.normals.dtype == np.float64


def test_a_map_without_depth_has_no_cloud(room: Path) -> None:
    with pytest.raises(mapmyworld.MapMyWorldError, match="neither depth images nor 3D scans"):
        mapmyworld.cloud(room.with_suffix(".db"))


def test_completion_in_a_notebook_shows_what_there_is() -> None:
    """Without importing anything: completion asks `dir`."""
    assert set(mapmyworld.__all__) <= set(dir(mapmyworld))


def test_completion_of_the_library_shows_the_verbs() -> None:
    assert {"build", "localise", "merge", "edit", "export"} <= set(dir(mapmyworld))
