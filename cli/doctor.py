"""`mapmyworld doctor`: is this machine ready, and what is missing."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import os
import platform
import sys
from dataclasses import dataclass

import click

import mapmyworld
from cli.arguments import format_option
from cli.exit_codes import EXIT_BAD_INPUT
from cli.standard_streams import show_result
from mapmyworld.open3d_library import PACKAGES

_NEEDED = ("numpy", "scipy", "numba", "gtsam", "cv2", "mcap", "rosbags", "rich", "click")
_distributions = functools.cache(importlib.metadata.packages_distributions)
# What an optional library is for, and what is said where it cannot be imported.
_OPTIONAL = {
    "embreex.rtcore_scene": (
        " (cameras of `simulate`)",
        "cameras of `simulate` need it ({}): it exists for x86-64",
    ),
    "open3d": (
        " (meshes)",
        f"meshes need it, and system libraries ({{}}): apt-get install {PACKAGES}",
    ),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at on this machine."""

    name: str
    ok: bool
    needed: bool
    text: str


@click.command()
@format_option
def doctor() -> None:
    """Say whether this machine is ready: versions, optional libraries, threads, cache."""
    system = f"{platform.python_version()} on {platform.platform()}"
    python = Finding("python", (3, 11) <= sys.version_info[:2] < (3, 15), True, system)
    threads = Finding("threads", True, False, f"{os.cpu_count()} cores")
    findings = [python, *map(_library, [*_NEEDED, *_OPTIONAL]), threads, _cache()]
    lines = [f"mapmyworld {mapmyworld.__version__}"]
    for finding in findings:
        mark = "ok" if finding.ok else ("MISSING" if finding.needed else "optional")
        lines.append(f"{mark:>8}  {finding.name}: {finding.text}")
    facts = {f.name: {"ok": f.ok, "needed": f.needed, "text": f.text} for f in findings}
    show_result(facts, lines)
    if any(f.needed and not f.ok for f in findings):
        sys.exit(EXIT_BAD_INPUT)


def _library(module: str) -> Finding:
    name = module.partition(".")[0]
    use, absent = _OPTIONAL.get(module, ("", "cannot be imported ({}); reinstall mapmyworld"))
    try:
        importlib.import_module(module)
        version = importlib.metadata.version(_distributions().get(name, [name])[0])
    except (ImportError, OSError) as error:
        return Finding(name, False, not use, absent.format(error))
    if name == "gtsam" and tuple(int(p) for p in version.split(".")[:2]) < (4, 3):
        return Finding(name, False, True, f"{version} crashes with NumPy 2: install gtsam 4.3")
    return Finding(name, True, not use, version + use)


def _cache() -> Finding:
    folder = os.path.dirname(os.path.abspath(mapmyworld.__file__))
    if os.environ.get("NUMBA_CACHE_DIR"):
        folder = os.environ["NUMBA_CACHE_DIR"]
    ok = os.access(folder, os.W_OK)
    text = f"compiled kernels are kept in {folder}"
    if not ok:
        text = f"{folder} is read-only: set NUMBA_CACHE_DIR, or kernels compile at every start"
    return Finding("kernel cache", ok, False, text)
