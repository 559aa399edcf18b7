"""Kernels compiled by several processes on a first start."""

from __future__ import annotations

import ast
import gc
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mapmyworld.kernels import first_start
from mapmyworld.kernels.first_kernels import KERNELS
from mapmyworld.types import Progress

ROOT = Path(first_start.__file__).parents[2]
WORDS = {"log", "scan", "camera", "odometry", "sight"}

SMALL = """
from mapmyworld.kernels import first_start
from mapmyworld.kernels.first_kernels import KERNELS
from numba.core import event
needs = frozenset({"log", "odometry", "sight"})
small = [k for k in KERNELS if k.needed_by in needs]
helped, compiled, reported = [], [], []
class Ear(event.Listener):
    def on_start(self, reported):
        compiled.append(reported.data["dispatcher"].py_func.__name__)
    def on_end(self, reported):
        pass
class Progress:
    def stage(self, name, total=None, unit=""): reported.append((name, total, unit))
    def update(self, done): reported.append(done)
    def note(self, message): reported.append(message)
start = first_start._helper
def helper(queue, reported):
    helped.append(start(queue, reported))
    return helped[-1]
first_start._helper = helper
event.register("numba:compile", Ear())
with first_start.compiled_ahead(needs, THREADS, Progress()):
    while_tracking = [first_start._is_kept(k) for k in small if needs & k.tracking]
import json
kept = [first_start._is_kept(k) for k in small]
again = len(compiled)
with first_start.compiled_ahead(needs, THREADS, Progress()) as all_there:
    assert all_there
print(json.dumps({
    "reported": reported, "kept": kept, "first": while_tracking,
    "helpers": [h.returncode for h in helped],
    "again": len(compiled) - again, "compiled": compiled, "names": [k.name for k in small],
}))
"""

BUILD = """
import json, sys
from mapmyworld.kernels import first_start
from numba.core import event
late, ahead, deep = [], [], [0]
class Ear(event.Listener):
    def on_start(self, reported):
        function = reported.data["dispatcher"].py_func
        if deep[0] == 0 and function.__module__.startswith("mapmyworld.kernels"):
            (ahead if first_start.busy else late).append(function.__name__)
        deep[0] += 1
    def on_end(self, reported):
        deep[0] -= 1
event.register("numba:compile", Ear())
first_start.busy = False
compile_one = first_start._compile
def compiling(kernel):
    first_start.busy = True
    try:
        compile_one(kernel)
    finally:
        first_start.busy = False
first_start._compile = compiling
from cli.main import main
sys.argv = ["mapmyworld", "build", LOG, "-o", OUT, "-q", "--set", "threads=2"]
try:
    main()
except SystemExit as end:
    assert not end.code
print(json.dumps({"late": late, "ahead": ahead}))
"""


def reported_by(script: str, cache: Path) -> dict[str, Any]:
    """What a fresh process with an empty cache prints last."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        env={**environment, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_the_table_names_kernels_that_python_calls() -> None:
    assert 20 < len(KERNELS) < 256  # their numbers are bytes
    for kernel in KERNELS:
        tree = ast.parse((ROOT / f"mapmyworld/kernels/{kernel.module}.py").read_text("utf-8"))
        function = next(
            n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == kernel.name
        )
        ways_in = [ast.unparse(decorator) for decorator in function.decorator_list]
        assert any("jit" in way for way in ways_in), kernel.name
        assert "inner_jit" not in ways_in, kernel.name
        taken = len(function.args.args)
        assert all(len(s.rstrip(",").split(", ")) == taken for s in kernel.signatures), kernel.name
        assert kernel.needed_by in WORDS


def test_two_processes_share_the_work_and_the_cache(tmp_path: Path) -> None:
    found = reported_by(SMALL.replace("THREADS", "2"), tmp_path)
    assert all(found["kept"])
    assert found["first"]
    assert all(found["first"])
    assert found["helpers"] == [0]
    assert found["reported"][0] == ["compile", len(found["names"]), "kernels"]
    assert found["again"] == 0  # a second start finds all of them, and indicates nothing
    by_itself = set(found["names"]) & set(found["compiled"])
    assert 0 < len(by_itself) < len(found["names"])


def test_one_thread_compiles_when_it_must(tmp_path: Path) -> None:
    found = reported_by(SMALL.replace("THREADS", "1"), tmp_path)
    assert found["helpers"] == found["reported"] == []
    assert not any(found["kept"])


def test_a_helper_whose_master_has_gone_takes_nothing_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled: list[str] = []
    monkeypatch.setattr(first_start, "_compile", lambda kernel: compiled.append(kernel.name))
    reading, writing = os.pipe()
    with first_start._queue_of([0, 1]) as queue:
        first_start.help_compiling(queue, writing, os.getpid())  # another process's child
    assert compiled == []
    with first_start._queue_of([0, 1]) as queue:
        first_start.help_compiling(queue, writing, os.getppid())
    assert compiled == [KERNELS[0].name, KERNELS[1].name]
    assert os.read(reading, 9) == bytes([0, 1])
    os.close(reading)
    os.close(writing)


def test_a_helper_that_cannot_start_leaves_the_work_to_this_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled: list[str] = []
    monkeypatch.setattr(first_start, "_is_kept", lambda kernel: False)
    monkeypatch.setattr(first_start, "_compile", lambda kernel: compiled.append(kernel.name))
    monkeypatch.setattr(
        subprocess, "Popen", lambda *_, **__: (_ for _ in ()).throw(OSError("no more"))
    )
    needed = [k for k in KERNELS if k.needed_by in {"log", "scan"}]
    first = [k.name for k in needed if k.tracking & {"log", "scan"}]
    with first_start.compiled_ahead(frozenset({"log", "scan"}), 2, Quiet()) as all_there:
        assert not all_there
        assert compiled == first
        assert gc.isenabled()
    assert sorted(compiled) == sorted(k.name for k in needed)


def test_a_helper_that_ends_before_time_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def take_one(queue: int, _: int) -> subprocess.Popen[bytes]:
        os.read(queue, 1)
        return subprocess.Popen(["true"])

    compiled: list[str] = []
    monkeypatch.setattr(first_start, "_is_kept", lambda kernel: False)
    monkeypatch.setattr(first_start, "_compile", lambda kernel: compiled.append(kernel.name))
    monkeypatch.setattr(first_start, "_helper", take_one)
    with first_start.compiled_ahead(frozenset({"log", "scan"}), 2, Quiet()):
        pass
    assert len(compiled) == len([k for k in KERNELS if k.needed_by in {"log", "scan"}]) - 1


def test_an_error_while_tracking_ends_the_helpers(monkeypatch: pytest.MonkeyPatch) -> None:
    helpers: list[subprocess.Popen[bytes]] = []

    def never_ending(*_: int) -> subprocess.Popen[bytes]:
        helpers.append(subprocess.Popen(["sleep", "60"]))
        return helpers[-1]

    monkeypatch.setattr(first_start, "_is_kept", lambda kernel: False)
    monkeypatch.setattr(first_start, "_compile", lambda kernel: None)
    monkeypatch.setattr(first_start, "_helper", never_ending)
    ahead = first_start.compiled_ahead(frozenset({"log", "scan"}), 2, Quiet())
    with pytest.raises(ValueError, match="lost"), ahead:
        raise ValueError("lost")
    assert [helper.returncode for helper in helpers] == [-9]


class Quiet(Progress):
    def stage(self, name: str, total: float | None = None, unit: str = "") -> None: ...

    def update(self, done: float) -> None: ...

    def note(self, message: str) -> None: ...


@pytest.mark.slow
def test_a_first_build_compiles_nothing_on_one_core(tmp_path: Path) -> None:
    """Every kernel that a build with laser and camera calls is in the table, as it is called."""
    log = ROOT / "sample_logs/apartment.mcap"
    script = BUILD.replace("LOG", repr(str(log))).replace("OUT", repr(str(tmp_path / "map.db")))
    found = reported_by(script, tmp_path / "cache")
    assert found["late"] == []
    assert len(found["ahead"]) >= 4
