"""The first hour, as a new user has it: items that each run a command and say what came.

Each function takes an empty folder, and gives what came and whether it is as it should be. Run
`python benchmarks/first_hour_more.py` for a table.
"""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
APARTMENT = ROOT / "sample_logs" / "apartment.mcap"
LASER = ("/graph_slam_bot/laser/scan", "/odom", "/tf", "/tf_static")
Came = tuple[str, bool]


def run(folder: Path, *words: object) -> tuple[int, str]:
    """A command's exit code, and all that it printed."""
    command = [sys.executable, "-m", "cli.main", *map(str, words)]
    found = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, timeout=900, check=False
    )
    return found.returncode, found.stdout + found.stderr


def built(folder: Path) -> Path:
    """The sample apartment's map."""
    run(folder, "build", APARTMENT, "-o", "map.db", "-q")
    return folder / "map.db"


def merged_camera(folder: Path) -> Came:
    """2: a camera session merged with an earlier one of the laser alone."""
    topics = [word for topic in LASER for word in ("--topic", topic)]
    run(folder, "convert", APARTMENT, "-o", "laser.mcap", *topics)
    run(folder, "convert", APARTMENT, "-o", "camera.mcap", "--start", 3)
    for name in ("laser", "camera"):
        run(folder, "build", f"{name}.mcap", "-o", f"{name}.db", "-q", "--no-export")
    code, _ = run(folder, "merge", "laser.db", "camera.db", "-o", "both.db", "-q")
    _, reported = run(folder, "inspect", "map", "both.db")
    line = next(line.strip() for line in reported.splitlines() if "camera:" in line)
    has_cloud = (folder / "both.ply").exists()
    return f"exit {code}; {line}; cloud: {has_cloud}", "none" not in line and has_cloud


def relations_of_a_part(folder: Path) -> Came:
    """4: relations of a whole drive against a map of a part of it."""
    path = built(folder).with_suffix(".tum")
    rows = np.loadtxt(path)
    moments = [(rows[0, 0], rows[0, 0] + 1e6)] * 8 + [(rows[0, 0], rows[0, 0])] * 2
    lines = [f"{a:.6f} {b:.6f} 0 0 0 0 0 0\n" for a, b in moments]
    (folder / "a.relations").write_text("".join(lines))
    code, reported = run(folder, "evaluate", "relations", "map.db", "a.relations")
    return f"exit {code}; {reported.splitlines()[0]}", code == 3 and "2 relations" in reported


def smaller_voxels(folder: Path) -> Came:
    """5: points of clouds with ever smaller voxels."""
    built(folder)
    counts = []
    for voxel in (0.05, 0.02, 0.01):
        run(folder, "export", "cloud", "map.db", "-o", "c.ply", "--voxel", voxel)
        head = (folder / "c.ply").read_bytes()[:400].decode("ascii", "replace")
        counts.append(int(head.split("element vertex ")[1].split()[0]))
    return f"{counts} points at 5, 2, 1 cm", counts == sorted(counts)


def contradicted_edit(folder: Path) -> Came:
    """6: a wrong addition is reported, with what it cost and what fights it."""
    built(folder)
    (folder / "e.toml").write_text(
        '[[add]]\nfrom = 3\nto = 150\npose = [4.2, 0, 90]\nsigma = [0.05, 2]\nreason = "wrong"\n'
    )
    code, reported = run(folder, "edit", "map.db", "e.toml", "-q")
    lost = reported.count("  rejected: ")
    fine = code == 3 and "is contradicted" in reported and "stand against the edits" in reported
    _, between = run(folder, "inspect", "graph", "map.db", "--between", 1, 50)
    turn = next(line for line in between.splitlines() if "turned" in line).split("turned ")[1]
    return f"exit {code}; {lost} constraints named as lost; turned {turn}", fine and turn[0] in "+-"


def late_odometry(folder: Path) -> Came:
    """10: settings that shift stamps, and messages that troubleshooting holds."""
    code, _ = run(folder, "build", APARTMENT, "-o", "s.db", "--no-export",
                     "--set", "sensing.odometry_offset=0.12")  # fmt: skip
    page = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    known = all(words in page for words in ("runs the wrong way", "header stamps step back"))

    return f"exit {code}; messages in troubleshooting: {known}", code == 0 and known


def python_paths(folder: Path) -> Came:
    """13: the library with paths, and its completion."""
    code = (
        "import mapmyworld as m\n"
        f"built = m.build({str(APARTMENT)!r}, into='map.db')\n"
        "print(built.result.nodes, len(m.export(built, 'out')), len(m.to_arrays(built)))\n"
        "print({'build', 'localise', 'merge', 'edit', 'export'} <= set(dir(m)))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, timeout=900,
        check=False,
    )  # fmt: skip
    return " ".join(found.stdout.split()) or found.stderr[-200:], "True" in found.stdout


def symmetric_information(folder: Path) -> Came:
    """14: information matrices that differ from their transpose."""
    with closing(sqlite3.connect(built(folder))) as database:
        blobs = [row[0] for row in database.execute("SELECT information_matrix FROM Link")]
    matrices = np.stack([np.frombuffer(blob, "<f8").reshape(6, 6) for blob in blobs])
    wrong = int((matrices != matrices.transpose(0, 2, 1)).any(axis=(1, 2)).sum())
    return f"{wrong} of {len(blobs)} differ from their transpose", wrong == 0


def sensors_left_out(folder: Path) -> Came:
    """17: real logs whose sensors no map can use yet: refused, or partial, with the reason."""
    reported = []
    for name in ("lidar3d/hku_1.mcap", "imu/euroc_v1_01.mcap"):
        log = ROOT.parent / "shared" / "data" / name
        code, words = run(folder, "build", log, "-o", "x.db", "-q") if log.exists() else (3, "")
        reported.append((log.stem, code, words.count("\n")))
    return f"{reported}", all(code in {2, 3} for _, code, _ in reported)


ITEMS: tuple[Callable[[Path], Came], ...] = (
    merged_camera, relations_of_a_part, smaller_voxels, contradicted_edit, late_odometry,
    python_paths, symmetric_information, sensors_left_out,
)  # fmt: skip


def main() -> None:
    """Runs every item in a folder of its own."""
    for item in ITEMS:
        with tempfile.TemporaryDirectory() as folder:
            came, fine = item(Path(folder))
        print("ok " if fine else "BAD", (item.__doc__ or "").strip(), "->", came, flush=True)


if __name__ == "__main__":
    main()
