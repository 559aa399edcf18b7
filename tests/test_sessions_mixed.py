"""Sessions of which one has a camera and the other has none, merged into one map."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from sample_maps import APARTMENT

from cli.main import group
from formats.cloud_files import read_cloud
from formats.database import MemoryMap, open_store
from mapmyworld.sessions.copying import copy_plan
from mapmyworld.stages.kept import has_images, has_scans

LASER = ("/graph_slam_bot/laser/scan", "/odom", "/tf", "/tf_static")


def run(*arguments: object) -> str:
    found = CliRunner().invoke(group, [str(a) for a in arguments])
    assert found.exit_code == 0, found.output + repr(found.exception)
    return found.output


@pytest.fixture(scope="module")
def merged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The apartment by laser alone, and then from its third second on with the camera as well."""
    folder = tmp_path_factory.mktemp("mixed")
    topics = [word for topic in LASER for word in ("--topic", topic)]
    run("convert", APARTMENT, "-o", folder / "laser.mcap", *topics, "-q")
    run("convert", APARTMENT, "-o", folder / "camera.mcap", "--start", 3, "-q")
    for name in ("laser", "camera"):
        run("build", folder / f"{name}.mcap", "-o", folder / f"{name}.db", "-q", "--no-export")
    run("merge", folder / "laser.db", folder / "camera.db", "-o", folder / "both.db", "-q")
    return folder / "both.db"


def test_a_camera_of_the_second_session_is_that_of_the_map(merged: Path) -> None:
    with open_store(merged, read_only=True) as store:
        assert not store.node_data(store.nodes()[0].id).images  # the first session has none
        assert has_images(store)
        assert has_scans(store)
    facts = json.loads(run("inspect", "map", merged, "--format", "json"))
    chosen = {d["role"]: d["choice"] for d in facts["plan"]["decisions"]}
    assert chosen["camera"].startswith("/camera_ir")
    assert facts["sessions"] == 2


def test_the_merged_map_has_the_cloud_of_that_camera(merged: Path) -> None:
    beside = read_cloud(merged.with_suffix(".ply"))
    assert beside.colours is not None
    assert beside.colours.std() > 15
    assert beside.points[:, 2].std() > 0.3
    run("export", "cloud", merged, "-o", merged.with_name("again.ply"))
    assert len(read_cloud(merged.with_name("again.ply")).points) == len(beside.points)


def test_each_role_is_decided_by_the_first_session_that_has_a_choice() -> None:
    plans = [
        {"planar": True, "decisions": [{"role": "camera", "choice": "", "reason": "no images"}]},
        {
            "decisions": [
                {"role": "camera", "choice": "/rgb", "reason": "fits"},
                {"role": "scan", "choice": "/scan", "reason": "10 Hz"},
            ],
            "losses": ["cut"],
        },
    ]
    stores = [MemoryMap(), MemoryMap(), MemoryMap()]
    for store, plan in zip(stores, plans, strict=False):
        store.put("plan", plan)
    copy_plan(stores[:2], stores[2])
    kept = stores[2].get("plan")
    assert [(d["role"], d["choice"]) for d in kept["decisions"]] == [
        ("camera", "/rgb"),
        ("scan", "/scan"),
    ]
    assert kept["planar"]
    assert kept["losses"] == ["cut"]
