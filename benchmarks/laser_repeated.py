"""A CARMEN log driven several times as one drive: there, back in reverse, there again, and so on.

python benchmarks/laser_repeated.py LOG REPEATED.clf [--times 4]

Every other time the records come in reverse order with mirrored stamps, so the robot never jumps:
it drives its path backwards. Odometry and scans are those of the log.
"""

from __future__ import annotations

import argparse
from decimal import Decimal
from pathlib import Path

from formats.logs.files import open_binary

_MOVING = (b"FLASER ", b"ODOM ")
_PAUSE = Decimal("0.2")  # s between two drives


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("repeated", type=Path)
    parser.add_argument("--times", type=int, default=4)
    arguments = parser.parse_args()
    written = repeat(arguments.log, arguments.repeated, arguments.times)
    print(f"{arguments.repeated}: {written} records")


def repeat(log: Path, repeated: Path, times: int) -> int:
    """Writes the log `times` times over; how many records that made."""
    with open_binary(log) as stream:
        lines = stream.readlines()
    head = [line for line in lines if line.startswith(b"PARAM")]
    records = [line.rsplit(None, 3) for line in lines if line.startswith(_MOVING)]
    stamps = [Decimal(record[1].decode()) for record in records]
    first, last = min(stamps), max(stamps)
    drive = last - first + _PAUSE
    with repeated.open("wb") as out:
        out.writelines(head)
        for time in range(times):
            back = time % 2 == 1
            order = reversed(range(len(records))) if back else range(len(records))
            for k in order:
                since = last - stamps[k] if back else stamps[k] - first
                stamp = f"{first + time * drive + since:.6f}".encode()
                content, _, host, _ = records[k]
                out.write(b" ".join([content, stamp, host, stamp]) + b"\n")
    return times * len(records)


if __name__ == "__main__":
    main()
