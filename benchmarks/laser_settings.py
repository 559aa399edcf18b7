"""What halving and doubling each laser setting does to the accuracy and cost of a log's map.

python benchmarks/laser_settings.py [LOG] [--data FOLDER] [--settings ROOM.NAME ...]

LOG is a name in the data's laser folder, or a path; a file of relations must lie beside it. Every
row is a whole build, so all of them take a while: an hour for fr079.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from common import DATA
from laser_logs import closures_of, errors_of

from formats.database import open_store
from formats.logs import open_log
from formats.relation_files import read_relations
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.config.settings import apply_settings
from mapmyworld.errors import ConfigError
from mapmyworld.pipeline import build_map

_ROOMS = ("registration", "odometry", "places")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("log", nargs="?", default="fr079")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--settings", nargs="*", default=laser_settings())
    arguments = parser.parse_args()
    path = Path(arguments.log)
    if not path.exists():
        path = arguments.data / "laser" / f"{arguments.log}.clf.bz2"
    print(f"{'setting':<38}{'trans. m':>18}{'rot. deg':>18}{'CPU s':>8}  closures", flush=True)
    run(path, "defaults", Config())
    for name in arguments.settings:
        room, field = name.split(".")
        default = getattr(getattr(Config(), room), field)
        for factor in (0.5, 2.0):
            value = type(default)(default * factor)
            label = f"{name}={value:g}"
            try:
                config = apply_settings(Config(), {name: str(value)})
            except ConfigError:
                print(f"{label:<38}  out of its range", flush=True)
                continue
            run(path, label, config)


def laser_settings() -> list[str]:
    """All settings of the laser's rooms that are numbers."""
    config = Config()
    return [
        f"{room}.{field}"
        for room in _ROOMS
        for field in getattr(config, room).__dataclass_fields__
        if type(getattr(getattr(config, room), field)) in (int, float)
    ]


def run(path: Path, label: str, config: Config) -> None:
    """Builds the log in a temporary folder and prints its row."""
    relations = read_relations(path.with_name(path.name.split(".")[0] + ".relations"))
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(Path(folder) / "map.db", create=True)
        cpu = time.process_time()
        build_map(open_log([path]), store, config, Silent())
        cpu = time.process_time() - cpu
        frames = store.frame_poses()
        assert frames is not None
        errors = errors_of(store, frames, relations)
        print(f"{label:<38}{errors}{cpu:8.1f}  {closures_of(store)}", flush=True)
        store.close()


if __name__ == "__main__":
    main()
