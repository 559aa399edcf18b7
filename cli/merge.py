"""`mapmyworld merge`: several maps become one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cli.arguments import PATH, format_option
from cli.config import config_options
from cli.progress import StderrProgress

if TYPE_CHECKING:
    from mapmyworld.config import Config


@click.command()
@click.argument("maps", metavar="MAP MAP...", nargs=-1, required=True, type=PATH)
@click.option("-o", "--output", required=True, type=PATH, help="The map database to write.")
@config_options
@click.option("--no-export", is_flag=True, help="Write the database only.")
@format_option
def merge(
    maps: tuple[Path, ...],
    output: Path,
    config: Config,
    no_export: bool,
) -> None:
    """Join finished MAPs whose sessions show the same place; their order does not matter.

    A session is recognised in another map by its scans or its images, and joined when many of
    them bear that out. Maps that do not connect are written as OUTPUT_2, ..., and the exit code
    is 3. The MAPs themselves are not changed.

    \b
    mapmyworld merge monday.db tuesday.db -o week.db
    """
    from cli.merging import merge_files, require_maps, require_results, show_merged

    if len(maps) < 2:
        raise click.UsageError("give at least two maps")
    require_maps(maps)
    require_results(output, maps, export=not no_export)
    progress = StderrProgress()
    summary = merge_files(maps, output, config, progress, export=not no_export)
    progress.finish()
    show_merged(summary)
