"""Files that stand beside logs and maps: clouds, meshes, paths, settings, edits, vocabularies.

Each is made small and sound, with the commands that read it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from formats.cloud_files import write_cloud, write_mesh
from formats.vocabulary_files import write_vocabulary
from mapmyworld.config.settings import as_toml
from mapmyworld.types import Mesh, PointCloud
from robust.fuzzing import Case

_SQUARE = [[-3, -3], [3, -3], [3, 3], [-3, 3]]  # metres
_BOX = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5],
        [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]  # fmt: skip
_ROUTE = ("--route", "start:0,0,0 0.3,0", "--no-camera", "-q")
_EDITS = """
[[reject]]
from = 1
to = 2
reason = "a fuzzer"
[[add]]
from = 1
to = 3
pose = [0.2, 0.0, 1.0]
sigma = [0.05, 2.0]
reason = "a tape"
[[prior]]
node = 1
pose = [0.0, 0.0, 0.0]
sigma = [0.01, 0.5]
reason = "the dock"
[[pin]]
node = 2
reason = "surveyed"
"""


class SmallFile(NamedTuple):
    """A file, the commands that read it, and what lies at OUT.db before each of them."""

    path: Path
    commands: list[tuple[str, ...]]
    beside: Path | None = None


def make_files(folder: Path, log: Path, made: Path) -> list[SmallFile]:
    """All of them; `log` is one that builds quickly and `made` a map with images."""
    folder.mkdir(parents=True, exist_ok=True)
    return [*_surfaces(folder), *_paths(folder, made), *_texts(folder, log, made)]


def cases(files: list[SmallFile], count: int, seed: int) -> Iterator[Case]:
    """`count` cases, all files and each file's commands in turn."""
    for i in range(count):
        file = files[i % len(files)]
        command = file.commands[(i // len(files)) % len(file.commands)]
        yield Case(file.path, command, (seed, i), file.beside)


def _surfaces(folder: Path) -> list[SmallFile]:
    corners = np.array([(x, y, z) for z in (0.0, 2.5) for x, y in _SQUARE], np.float32)
    grey = np.full((len(corners), 3), 90, np.uint8)
    mesh, cloud = Mesh(corners, np.array(_BOX, np.int32), grey), PointCloud(corners, grey, corners)
    write_mesh(folder / "mesh.ply", mesh)
    for name in ("cloud.ply", "cloud.pcd"):
        write_cloud(folder / name, cloud)
    head = "ply\nformat ascii 1.0\nelement vertex 8\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {colour}\n" for colour in ("red", "green", "blue"))
    rows = "".join(f"{x} {y} {z} 9 9 9\n" for x, y, z in corners.tolist())
    (folder / "text.ply").write_text(f"{head}end_header\n{rows}")
    sides = "".join("f " + " ".join(str(i + 1) for i in side) + "\n" for side in _BOX)
    rows = "".join(f"v {x} {y} {z}\n" for x, y, z in corners.tolist())
    (folder / "world.obj").write_text(rows + sides)
    true = str(folder / "mesh.ply")
    score = [("evaluate", "cloud", "FILE", true)]
    drive = [("simulate", "--world", "FILE", "-o", "OUT.mcap", *_ROUTE)]
    other = ("evaluate", "cloud", str(folder / "cloud.ply"), "FILE")
    found = [SmallFile(folder / n, score) for n in ("cloud.ply", "cloud.pcd", "text.ply")]
    return [
        *found, SmallFile(folder / "mesh.ply", [other, *drive]),
        SmallFile(folder / "world.obj", drive),
    ]  # fmt: skip


def _paths(folder: Path, made: Path) -> list[SmallFile]:
    path = made.with_suffix(".tum")
    truth = folder / "truth"
    truth.mkdir(exist_ok=True)
    lines = path.read_text().splitlines()
    stamps = [line.split()[0] for line in lines if line[:1].isdigit()]
    nanoseconds = [round(float(stamp) * 1e9) for stamp in stamps]
    (truth / "trajectory.tum").write_text(path.read_text())
    (truth / "loop_pairs.csv").write_text(
        "first_stamp_ns,second_stamp_ns,x,y,yaw\n"
        + "".join(f"{nanoseconds[0]},{stamp},0.1,0.0,0.2\n" for stamp in nanoseconds[-2:])
    )
    (folder / "path.relations").write_text(
        "".join(f"{stamps[0]} {stamp} 0.1 0 0 0 0 0.1\n" for stamp in stamps[1:5])
    )
    (folder / "path.tum").write_text(path.read_text())
    known, relations = str(truth / "trajectory.tum"), str(folder / "path.relations")
    return [
        SmallFile(
            folder / "path.tum",
            [
                ("evaluate", "trajectory", "FILE", known),
                ("evaluate", "trajectory", known, "FILE", "--format", "json"),
                ("evaluate", "relations", "FILE", relations),
            ],
        ),
        SmallFile(folder / "path.relations", [("evaluate", "relations", known, "FILE")]),
        SmallFile(truth, [("evaluate", "loops", str(made), "FILE/trajectory.tum")]),
    ]


def _texts(folder: Path, log: Path, made: Path) -> list[SmallFile]:
    (folder / "edits.toml").write_text(_EDITS)
    (folder / "settings.toml").write_text(as_toml())
    rng = np.random.default_rng(6)
    words = {n: rng.integers(0, 256, 32).astype(np.uint8) for n in range(1, 40)}
    write_vocabulary(folder / "words.txt", words)
    build = ("build", str(log), "-o", "OUT.db", "-q")
    return [
        SmallFile(folder / "edits.toml", [("edit", "OUT.db", "FILE", "-q")], beside=made),
        SmallFile(folder / "settings.toml", [(*build, "--config", "FILE")]),
        SmallFile(folder / "words.txt", [(*build, "--set", "places.vocabulary=FILE")]),
    ]
