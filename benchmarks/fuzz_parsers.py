"""Coverage-guided fuzzing of the parsers, by Atheris (`pip install atheris`).

python benchmarks/fuzz_parsers.py mcap CORPUS_FOLDER [-max_total_time=3600]

The folder keeps what reaches new code, and the next run goes on from there; where it is empty it
is given sound files first. Bytes become a file of the kind; whatever but our own errors gets out,
or a warning is a finding, which Atheris writes down and stops at. The options are libFuzzer's.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import atheris
import cv2
import numpy as np

_INTERPRETED = "NUMBA_DISABLE_JIT"
os.environ[_INTERPRETED] = "1"  # compiled kernels would be blind to it
with atheris.instrument_imports(include=["formats", "mapmyworld", "rosbags"]):
    from formats.cloud_files import read_cloud
    from formats.database import open_store
    from formats.edit_files import read_edits
    from formats.graph_reading import read_graph
    from formats.grid_files import read_grid
    from formats.logs import foxglove_decoders, open_log, ros_decoders
    from formats.logs.channels import Channel
    from formats.logs.decoding import decoder_for
    from formats.logs.definitions import standard_store
    from formats.nested_text import read_toml
    from formats.relation_files import read_relations
    from formats.scene_mesh import read_scene_mesh
    from formats.trajectory_files import read_trajectory
    from formats.truth_files import read_loop_pairs
    from formats.vocabulary_files import read_vocabulary
    from mapmyworld.config import Config
    from mapmyworld.config.settings import apply_settings, flatten
    from mapmyworld.errors import LogError, MapMyWorldError
    from mapmyworld.types import ImageMessage

# Run elsewhere: what watches the parsers here cannot be compiled.
_SOUND = """
import sys
from pathlib import Path
from robust import corpus
folder, ending = Path(sys.argv[1]), sys.argv[2]
logs = corpus.make_logs(folder / "logs")
corpus.make_graphs(folder / "graphs")
if ending == ".db":
    corpus.make_maps(folder / "maps", next(log for log in logs if log.name == "whole.mcap"))
"""
_MOST_MESSAGES = 2000
_MOST_OF_A_TOPIC = 3  # messages that become seeds
CHANNELS = [
    Channel("/topic", name, encoding)
    for name in sorted(ros_decoders.CONVERTERS)
    for encoding in ("ros1", "cdr")
] + [Channel("/topic", f"foxglove.{name}", "json") for name in sorted(foxglove_decoders.CONVERTERS)]
_LISTS = (  # of a TUM folder
    b"# colour\n1.5 1.png\n2.5 1.png\n\0\0# depth\n1.51 1.png\n2.5 1.png\n"
    b"\0\0# truth\n1.5 0 0 0 0 0 0 1\n\0\0fx: 525.0\nfy: 525.0\ncx: 31.5\ncy: 23.5\n"
)
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
    log.info()


def _tum(path: Path) -> None:
    """The lists of a TUM folder's colour and depth, its truth and its calibration."""
    names = ("rgb.txt", "depth.txt", "groundtruth.txt", "calibration.yaml")
    folder = FOLDER / "tum"
    if not folder.exists():
        folder.mkdir()
        picture = cv2.imencode(".png", np.full((48, 64), 9000, np.uint16))[1].tobytes()
        (folder / "1.png").write_bytes(picture)
    for name, data in zip_longest(names, path.read_bytes().split(b"\0\0", 3), fillvalue=b""):
        (folder / name).write_bytes(data)
    _log(folder)


def _settings(path: Path) -> None:
    apply_settings(Config(), flatten(read_toml(path)))


def _message(path: Path) -> None:
    """The first byte names the channel, the rest is one message: no container is in its way."""
    data = path.read_bytes()
    _decode(_channel(data), data[1:])


def _definition(path: Path) -> None:
    """As a message, of a type that the bytes before the two zeros define."""
    data = path.read_bytes()
    schema, _, body = data[1:].partition(b"\0\0")
    channel = _channel(data)
    kind = {"ros1": "ros1msg", "cdr": "ros2idl" if b"module" in schema else "ros2msg"}
    encoding = kind.get(channel.encoding, "jsonschema")
    _decode(replace(channel, schema_encoding=encoding, schema=schema), body)


def _channel(data: bytes) -> Channel:
    return CHANNELS[data[0] % len(CHANNELS)] if data else CHANNELS[0]


def _decode(channel: Channel, body: bytes) -> None:
    decoder = decoder_for(channel)
    message = decoder.message(body, 0).decode()
    if isinstance(message, ImageMessage):
        message.pixels()


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
    "toro": (".graph", read_graph, b""),
    "trajectory": (".tum", read_trajectory, b""),
    "edits": (".toml", read_edits, b""),
    "loops": (".txt", read_loop_pairs, b""),
    "vocabulary": (".txt", read_vocabulary, b""),
    "cloud": (".ply", read_cloud, b"ply\n"),
    "obj": (".obj", read_scene_mesh, b""),
    "glb": (".glb", read_scene_mesh, b"glTF"),
    "mesh": (".ply", read_scene_mesh, b"ply\n"),
    "pcd": (".pcd", read_cloud, b"# .PCD v0.7"),
    "relations": (".relations", read_relations, b""),
    "message": (".message", _message, b""),
    "definition": (".definition", _definition, b""),
    "tum": (".lists", _tum, b""),
    "settings": (".toml", _settings, b""),
}


def _give_seeds(folder: Path, ending: str) -> None:
    """Sound files of that ending, as far as the campaigns with fixed seeds make some."""
    made = FOLDER / "sound"
    made.mkdir()
    environment = {name: value for name, value in os.environ.items() if name != _INTERPRETED}
    command = [sys.executable, "-c", _SOUND, str(made), ending]
    subprocess.run(command, cwd=Path(__file__).parent, env=environment, check=True)
    for number, file in enumerate(sorted(made.rglob(f"*{ending}"))):
        if file.is_file():
            shutil.copyfile(file, folder / f"sound-{number}")
    if ending == ".lists":
        (folder / "sound").write_bytes(_LISTS)
    if ending in (".message", ".definition"):
        for log in ("whole.mcap", "whole.bag", "json.mcap"):
            _give_messages(folder, made / "logs" / log, defined=ending == ".definition")


def _give_messages(folder: Path, log: Path, *, defined: bool) -> None:
    """The first messages of every type: its channel, where `defined` its definition, its bytes."""
    numbers = {(one.type_name, one.encoding): k for k, one in enumerate(CHANNELS)}
    seen: Counter[tuple[str, str]] = Counter()
    for _, channel, data in open_log([log]).records():  # type: ignore[attr-defined]
        kind = (channel.type_name, channel.encoding)
        if kind in numbers and seen[kind] < _MOST_OF_A_TOPIC:
            name = f"sound-{log.name}-{numbers[kind]}-{seen[kind]}"
            schema = channel.schema + b"\0\0" if defined else b""
            (folder / name).write_bytes(bytes([numbers[kind]]) + schema + data)
            seen[kind] += 1


def main() -> None:
    if len(sys.argv) < 2 or sys.argv[1] not in KINDS:
        sys.exit(f"usage: fuzz_parsers.py KIND ...; KIND is one of {', '.join(KINDS)}")
    kind = sys.argv.pop(1)
    ending, read, magic = KINDS[kind]
    path = FOLDER / f"case{ending}"
    folders = [Path(word) for word in sys.argv[1:] if not word.startswith("-")]
    if folders and folders[0].is_dir() and not any(folders[0].iterdir()):
        _give_seeds(folders[0], ending)

    def one(data: bytes) -> None:
        path.write_bytes(data if data.startswith(magic) else magic + data)
        with suppress(MapMyWorldError):
            read(path)

    for encoding in ("ros1", "cdr"):
        standard_store(encoding)  # made once, not by the first case
    warnings.simplefilter("error")  # which a user would see; compiled, kernels give none
    # Bytes that wrap around are meant; compiled, they do so without a word.
    warnings.filterwarnings("ignore", module=r"formats\.rvl")
    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
