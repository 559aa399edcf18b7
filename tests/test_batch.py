"""Many logs: the manifest, the summary, and that a batch goes on where it stopped."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from robust import batches
from robust.trials import try_command, wait_for_tables
from room_drive import drive

from cli.batching.manifest import read_manifest
from cli.batching.summary import FORMS
from mapmyworld.errors import ConfigError

MANIFEST = """
[defaults]
require = ["nodes >= 5"]

[[log]]
log = "good.mcap"

[[log]]
log = "broken.mcap"

[[log]]
name = "strict"
log = "good.mcap"
set = { "mapping.resolution" = 0.1 }
require = ["nodes >= 100000"]
"""


def test_a_manifest_with_faults_names_them_all(tmp_path: Path) -> None:
    path = tmp_path / "logs.toml"
    path.write_text(
        '[[log]]\nlog = "a.bag"\nmethod = "magic"\n[[log]]\nname = "../up"\nlog = "b.bag"\n'
        '[[log]]\nlog = "c.bag"\nset = { "mapping.resolutoin" = 1 }\nrequire = ["beauty > 3"]\n'
        '[[log]]\nname = "c"\nlog = "d.bag"\nspeed = 3\n'
    )
    with pytest.raises(ConfigError) as caught:
        read_manifest(path)
    for word in ("magic", "../up", "did you mean", "beauty", "two logs are called 'c'", "speed"):
        assert word in str(caught.value)


@pytest.mark.slow
def test_a_batch_sums_up_goes_on_and_gives_the_same_again(tmp_path: Path) -> None:
    drive(25).write(tmp_path / "good.mcap")
    (tmp_path / "broken.mcap").write_bytes(b"no log" * 100)
    (tmp_path / "logs.toml").write_text(MANIFEST)
    out = tmp_path / "out"
    command = ["batch", str(tmp_path / "logs.toml"), "-o", str(out), "--format", "json"]
    # The trial takes 2 for a refusal in one line; here it is the summary's verdict.
    first = try_command(command, seconds=120.0)
    assert first.exit_code == 2
    reported = json.loads(first.stdout)
    assert {log["name"]: log["status"] for log in reported["logs"]} == {
        "good": "built", "broken": "failed", "strict": "built",
    }  # fmt: skip
    assert reported["unmet"] == 1
    suite = ElementTree.parse(out / "summary.xml").getroot()
    assert (suite.get("tests"), suite.get("errors"), suite.get("failures")) == ("3", "1", "1")
    assert "UNMET" in (out / "summary.html").read_text("utf-8")
    words = (out / "summary.txt").read_text("utf-8")
    assert re.search(r"\(is \d+, ", words)  # a count is no 16.0
    assert "(no map to measure)" in words
    assert "None" not in words
    before = {name: (out / name).read_bytes() for name in FORMS}
    built = (out / "good" / "map.db").stat().st_mtime_ns
    (out / "strict" / "result.json").unlink()  # as if killed before its end
    again = try_command(command, seconds=120.0)
    assert "1 of 3 logs are finished already" in again.stderr  # the broken one is tried again
    assert {name: (out / name).read_bytes() for name in FORMS} == before
    assert (out / "good" / "map.db").stat().st_mtime_ns == built


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    """A manifest of two short logs and three broken ones, and what an unbroken batch makes."""
    folder = tmp_path_factory.mktemp("batch")
    manifest = batches.write_logs(folder, 5, broken=3)
    ran = batches.run_batch(manifest, folder / "whole")
    assert ran.exit_code == 2, ran.stderr
    assert "2 built, 0 partial, 3 failed" in ran.stdout
    return manifest, batches.products(folder / "whole")


@pytest.mark.slow
def test_a_killed_build_and_a_killed_batch_change_no_byte(
    whole: tuple[Path, dict[str, bytes]],
) -> None:
    manifest, expected = whole
    output = manifest.parent / "killed"
    assert batches.kill_batch(manifest, output, 0, 1, "--jobs", "1") == 0
    assert not (output / "summary.json").exists()
    ran = batches.run_batch(manifest, output)
    assert ran.exit_code == 2
    assert "1 of 5 logs are finished already" in ran.stderr
    assert batches.differences(expected, batches.products(output)) == []


@pytest.mark.slow
def test_ctrl_c_to_the_batch_alone_ends_its_builds_in_order(tmp_path: Path) -> None:
    drive(3000).write(tmp_path / "long.mcap")
    (tmp_path / "logs.toml").write_text('[[log]]\nlog = "long.mcap"\n')
    map_db = tmp_path / "batch" / "long" / "map.db"
    process = subprocess.Popen(
        [sys.executable, "-m", "cli.main", "batch", str(tmp_path / "logs.toml")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)},
        stderr=subprocess.PIPE,
        text=True,
        # What a script starts in the background has Ctrl-C ignored, its children too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_for_tables(map_db, process)
    build = _child_of(process.pid)
    os.kill(build, signal.SIGSTOP)  # a fast machine would finish it before it is asked to end
    assert not (map_db.parent / "map.pgm").exists(), "this log is too short for the test"
    process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + 60.0
    while not _was_asked_to_end(build):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert process.poll() is None, "the build is waited for"
    os.kill(build, signal.SIGCONT)
    _, reported = process.communicate(timeout=60)
    assert (process.returncode, "interrupted" in reported) == (130, True)
    assert not Path(f"/proc/{build}").exists()
    assert not (map_db.parent / "map.pgm").exists(), "the build went on to its end"
    found = try_command(["inspect", "map", str(map_db)])  # sound, of a build that had no node
    assert found.exit_code == 2
    assert "did not get that far" in found.stderr


def _child_of(process: int) -> int:
    children = Path(f"/proc/{process}/task").glob("*/children")
    return int(next(word for file in children for word in file.read_text().split()))


def _was_asked_to_end(stopped: int) -> bool:
    """Whether SIGINT waits for a stopped process to go on."""
    status = Path(f"/proc/{stopped}/status").read_text()
    waiting = next(line for line in status.splitlines() if line.startswith("ShdPnd:"))
    return bool(int(waiting.split()[1], 16) >> (signal.SIGINT - 1) & 1)


@pytest.mark.slow
def test_two_workers_of_a_cluster_change_no_byte(whole: tuple[Path, dict[str, bytes]]) -> None:
    from distributed import LocalCluster

    manifest, expected = whole
    output = manifest.parent / "cluster"
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(processes=True, **options) as dask:
        ran = batches.run_batch(manifest, output, "--scheduler", dask.scheduler_address)
    assert ran.exit_code == 2
    assert batches.differences(expected, batches.products(output)) == []


def test_a_cluster_out_of_reach_is_named(tmp_path: Path) -> None:
    (tmp_path / "logs.toml").write_text('[[log]]\nlog = "absent.bag"\n')
    command = ["batch", str(tmp_path / "logs.toml"), "-o", str(tmp_path / "out"), "-q"]
    tried = try_command([*command, "--scheduler", "nonsense://nowhere:1"])
    assert tried.exit_code == 2
    assert tried.fault == ""
    assert "cannot be reached" in tried.stderr
