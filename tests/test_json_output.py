"""What every command prints with --format json, of maps of many kinds, against its schema."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import jsonschema
import pytest
from conftest import ROOT
from docs_commands import run
from room_drive import drive
from sample_maps import APARTMENT, apartment  # noqa: F401

from cli.main import group

SCHEMAS = ROOT / "docs" / "schemas"
TRUTH = APARTMENT.with_name("apartment.mcap.truth")
# Other layouts of one command, chosen by an option.
VARIANTS = {"build-dry-run": "build", "check-keys": "check", "simulate-list": "simulate"}
BATCH = """
[defaults]
require = ["nodes >= 3", "nodes >= 10000"]
[[log]]
log = "room.mcap"
[[log]]
log = "broken.mcap"
"""


def commands(inside: click.Group = group, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Words of every command that takes --format."""
    context = click.Context(inside)
    for name in inside.list_commands(context):
        command = inside.get_command(context, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*words, name))
        elif command is not None and any("--format" in p.opts for p in command.params):
            yield words if words == ("export",) else (*words, name)


def schema_of(name: str) -> Any:
    return json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))


def closed(schema: Any) -> Any:
    """The schema, with no names beside those that it lists."""
    if isinstance(schema, list):
        return [closed(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: closed(value) for key, value in schema.items()}
    if "properties" in found and "additionalProperties" not in found:
        found["additionalProperties"] = False
    return found


def holds(line: str, name: str, status: int = 0) -> Any:
    found, out, err = run(f"mapmyworld {line} --format json")
    assert found == status, f"{line}\n{err}"
    document = json.loads(out)
    jsonschema.validate(document, closed(schema_of(name)))
    return document


def test_every_command_that_prints_json_has_a_schema() -> None:
    wanted = {"-".join(words) for words in commands()} | set(VARIANTS)
    assert {path.stem for path in SCHEMAS.glob("*.json")} == wanted
    text = (ROOT / "docs" / "json.md").read_text(encoding="utf-8")
    for name in wanted:
        assert f"(schemas/{name}.json)" in text
        jsonschema.Draft202012Validator.check_schema(schema_of(name))


def test_every_name_of_a_schema_is_explained() -> None:
    def silent(schema: Any, where: str) -> Iterator[str]:
        for name, inner in schema.get("properties", {}).items():
            if not inner.get("description"):
                yield f"{where}.{name}"
            yield from silent(inner, f"{where}.{name}")
        for key in ("items", "additionalProperties"):
            if isinstance(schema.get(key), dict):
                yield from silent(schema[key], where)

    assert [
        n for path in SCHEMAS.glob("*.json") for n in silent(schema_of(path.stem), path.stem)
    ] == []


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a small room, one without odometry, one of a smaller room, and a broken log."""
    folder = tmp_path_factory.mktemp("json")
    drive(40).write(folder / "room.mcap")
    drive(40).without("/odom").write(folder / "alone.mcap")
    smaller = drive(40).changed("/scan", lambda scan: replace(scan, ranges=0.6 * scan.ranges))
    smaller.write(folder / "smaller.mcap")
    (folder / "broken.mcap").write_bytes(b"no log" * 100)
    (folder / "logs.toml").write_text(BATCH)
    (folder / "a.relations").write_text("1700000001 1700000002 0 0 0 0 0 0.5\n")
    return folder


@pytest.mark.slow
def test_json_of_small_maps(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    holds("build room.mcap -o room.db -q", "build")
    holds("build room.mcap -o again.db -q", "build")
    holds("build room.mcap -o particles.db --method fastslam --set particles.count=4 -q", "build")
    holds("build alone.mcap -o alone.db -q", "build")
    run("mapmyworld build smaller.mcap -o smaller.db -q")
    holds("build room.mcap --dry-run", "build-dry-run")
    holds("build alone.mcap --dry-run", "build-dry-run")
    for name in ("room", "particles", "alone"):
        holds(f"inspect graph {name}.db", "inspect-graph")
        holds(f"inspect node {name}.db 2", "inspect-node")
        holds(f"inspect map {name}.db", "inspect-map")
        holds(f"check {name}.db --require 'nodes >= 1'", "check")
    for log in ("room.mcap", "alone.mcap"):
        holds(f"inspect log {log}", "inspect-log")
    holds("inspect log room.mcap --quick", "inspect-log")
    holds("check room.db --require 'nodes >= 1000'", "check", 4)
    holds("check room.db --keys", "check-keys")
    holds("check absent.db --keys", "check-keys")
    holds("compare room.db alone.db particles.db", "compare")
    holds("evaluate relations room.db a.relations", "evaluate-relations")
    holds("merge room.db again.db -o both.db -q", "merge")
    holds("merge room.db alone.db -o more.db -q --no-export", "merge")
    holds("merge room.db smaller.db -o apart.db -q --no-export", "merge", 3)
    holds("inspect map both.db", "inspect-map")
    holds("inspect graph both.db", "inspect-graph")
    holds("localise room.db room.mcap -o found.tum -q", "localise")
    holds("optimise room.db -o solved.db", "optimise")
    assert holds("export graph room.db -o room.g2o", "export")["files"] == ["room.g2o"]
    holds("export grid room.db -o floor", "export")
    holds("optimise room.g2o", "optimise")
    reported = holds("batch logs.toml -o batch -q", "batch", 2)
    assert (reported["failed"], reported["unmet"]) == (1, 1)


@pytest.mark.slow
def test_json_of_programs_about_themselves(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    holds("doctor", "doctor")
    holds("config", "config")
    holds("simulate --list", "simulate-list")
    holds("simulate hall --no-camera --route 1,0 -o hall.mcap -q", "simulate")


@pytest.mark.slow
def test_json_of_a_map_with_images(
    apartment: Path,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("map.db").write_bytes(apartment.read_bytes())
    log, grid = shlex.quote(str(APARTMENT)), apartment.with_suffix(".yaml")
    found = holds(f"build {log} -o map.db -q", "build")
    assert found["reused_stages"]
    reported = holds(f"inspect log {log}", "inspect-log")
    assert {"floor tilt", "odometry scale"} <= {f["name"] for f in reported["diagnosis"]}
    holds("inspect graph", "inspect-graph")
    holds("inspect node 1", "inspect-node")
    holds("inspect map", "inspect-map")
    holds("check --require 'nodes >= 1' --require 'nodes <= 9'", "check", 4)
    holds(f"compare map.db {apartment}", "compare")
    holds(f"evaluate trajectory map.db {TRUTH}/trajectory.tum", "evaluate-trajectory")
    holds(f"evaluate grid {grid} {TRUTH}/grid.yaml", "evaluate-grid")
    holds(f"evaluate cloud {apartment.with_suffix('.ply')} {TRUTH}/mesh.ply", "evaluate-cloud")
    holds(f"evaluate loops map.db {TRUTH}/trajectory.tum", "evaluate-loops")
