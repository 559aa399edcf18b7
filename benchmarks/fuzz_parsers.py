"""Coverage-guided fuzzing of the parsers, by Atheris (`pip install atheris`).

python benchmarks/fuzz_parsers.py mcap [-max_total_time=3600] [CORPUS_FOLDER]

Bytes become a file of the kind; whatever but our own errors gets out is a finding, which Atheris
writes down and stops at. The options behind the kind are libFuzzer's.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["formats", "mapmyworld"]):
    from formats.database import open_store
    from formats.grid import read_grid
    from formats.logs import open_log
    from formats.pose_graph import read_graph
    from formats.relations import read_relations
    from formats.trajectory import read_trajectory
    from mapmyworld.errors import LogError, MapMyWorldError
    from mapmyworld.types import ImageMessage

_MOST_MESSAGES = 2000
FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-"))


def _log(path: Path) -> None:
    log = open_log([path])
    log.info()
    for number, raw in enumerate(log.messages()):
        try:
            message = raw.decode()
            if isinstance(message, ImageMessage):
                message.pixels()
        except LogError:
            pass
        if number > _MOST_MESSAGES:
            break
    log.losses()


def _map(path: Path) -> None:
    with open_store(path, read_only=True) as store:
        for node in store.nodes()[:20]:
            store.node_data(node.id)
        store.constraints()
        store.poses()
        store.grid()


def _grid(path: Path) -> None:
    """The first half is the YAML, the rest the picture."""
    data = path.read_bytes()
    middle = data.find(b"\0\0")
    (FOLDER / "map.pgm").write_bytes(data[middle + 2 :] if middle >= 0 else b"")
    path.write_bytes(data[:middle] if middle >= 0 else data)
    read_grid(path)


# Kind -> ending of the file, its reader, bytes it begins with.
KINDS: dict[str, tuple[str, Callable[[Path], object], bytes]] = {
    "mcap": (".mcap", _log, b"\x89MCAP0\r\n"),
    "bag": (".bag", _log, b"#ROSBAG V2.0\n"),
    "db3": (".db3", _log, b"SQLite format 3\0"),
    "carmen": (".log", _log, b"# CARMEN Logfile\n"),
    "map": (".db", _map, b"SQLite format 3\0"),
    "g2o": (".g2o", read_graph, b""),
    "grid": (".yaml", _grid, b""),
    "trajectory": (".tum", read_trajectory, b""),
    "relations": (".relations", read_relations, b""),
}


def main() -> None:
    if len(sys.argv) < 2 or sys.argv[1] not in KINDS:
        sys.exit(f"usage: fuzz_parsers.py KIND ...; KIND is one of {', '.join(KINDS)}")
    ending, read, magic = KINDS[sys.argv.pop(1)]
    path = FOLDER / f"case{ending}"

    def one(data: bytes) -> None:
        path.write_bytes(data if data.startswith(magic) else magic + data)
        with suppress(MapMyWorldError):
            read(path)

    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
