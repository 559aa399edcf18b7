"""`mapmyworld convert`: any readable log as MCAP, ROS 1 bag or rosbag2."""

from __future__ import annotations

from pathlib import Path

import click

from cli.arguments import PATH, FiniteRange
from cli.manners import note
from cli.outputs import require_apart, require_output_name
from cli.progress import StderrProgress
from cli.standard_streams import end_partial


@click.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option(
    "-o", "--output", required=True, type=PATH,
    help="OUT.mcap, OUT.bag, OUT.db3, or a folder for a rosbag2 recording.",
)  # fmt: skip
@click.option(
    "--start",
    type=FiniteRange(0),
    default=0.0,
    metavar="S",
    help="Seconds of the log to leave out first, but for /tf_static.",
)
@click.option(
    "--duration", type=FiniteRange(0), metavar="S",
    help="Seconds of the log to write; all when not given.",
)  # fmt: skip
@click.option("--topic", "topics", multiple=True, help="Only this topic; may be repeated.")
@click.option(
    "--compress", type=click.Choice(["none", "lz4", "zstd", "bz2"]),
    help="Compression of the output: zstd for .mcap, none for the others unless set.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace the output where it exists.")
def convert(
    logs: tuple[Path, ...],
    output: Path,
    start: float,
    duration: float | None,
    topics: tuple[str, ...],
    compress: str | None,
    overwrite: bool,
) -> None:
    """Write any readable log, or several parts of one, as another kind of log.

    Messages keep their bytes where the output takes their encoding (MCAP takes all); CARMEN logs
    and TUM folders become standard ROS messages from which the same map results.

    \b
    mapmyworld convert intel.clf.bz2 -o intel.mcap
    mapmyworld convert part_0.bag part_1.bag -o whole.mcap --topic /scan --topic /odom
    """
    from formats.converting import convert_log
    from formats.logs import open_log

    require_output_name(output)
    require_apart(output, logs)
    log = open_log(logs)
    progress = StderrProgress()
    result = convert_log(
        log, output, topics=frozenset(topics) or None, start_s=start, duration_s=duration,
        compression=compress, overwrite=overwrite, progress=progress,
    )  # fmt: skip
    progress.finish()
    note(f"{output}: {result.messages} messages, {result.duration_s:.2f} s of recording")
    end_partial(result.losses)
