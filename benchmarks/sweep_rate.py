"""How fast lasers sweep, as turns of the robot show it, and as their messages state it.

    python benchmarks/sweep_rate.py LOG...

Milliseconds a radian of the sweep, with the standard error. What messages state is not used: the
measurement should come to it where they do. It is less where wheels or stamps indicate little of
how the robot turned.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from formats.logs.opening_logs import open_log
from mapmyworld.api import Silent
from mapmyworld.config import Config
from mapmyworld.stages.first_pass import deskewed
from mapmyworld.stages.plan_log import plan_log
from mapmyworld.types import LaserScanMessage


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("logs", nargs="+", type=Path)
    config, progress = Config(), Silent()
    for path in parser.parse_args().logs:
        log = open_log([path])
        plan = plan_log(log, config, progress)
        if plan.scan is None or plan.scan.is_cloud:
            print(f"{path.name}: no laser")
            continue
        first = next(iter(log.messages([plan.scan.topic]))).decode()
        assert isinstance(first, LaserScanMessage)
        stated = 1e3 * first.time_increment / abs(first.angle_increment)
        unsaid = replace(plan, scan=replace(plan.scan, beams_are_timed=False))
        found = deskewed(log, unsaid, config, progress).decisions[-1]
        print(f"{path.name}: {found.reason}; stated {stated:.1f}", flush=True)


if __name__ == "__main__":
    main()
