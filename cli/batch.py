"""`mapmyworld batch`: many logs, each built and checked, and one summary."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cli.arguments import PATH, format_option
from cli.manners import note
from cli.standard_streams import show_result

if TYPE_CHECKING:
    from cli.batching.job import Result


@click.command()
@click.argument("manifest", metavar="FOLDER|MANIFEST.toml", type=PATH)
@click.option(
    "-o",
    "--output",
    default="batch",
    help="Folder for all that is made, or its URL.",
)
@click.option(
    "-j",
    "--jobs",
    "at_once",
    type=click.IntRange(0),
    default=0,
    show_default=False,
    help="Builds at a time.  [default: as many as cores]",
)
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Run on a Dask cluster's workers.")
@click.option("--again", is_flag=True, help="Build finished logs again.")
@format_option
def batch(
    manifest: Path,
    output: str,
    at_once: int,
    scheduler: str | None,
    again: bool,
) -> None:
    """Build the map of every log in FOLDER, check it, and sum up: text, JSON, JUnit and HTML.

    A MANIFEST names the logs instead, with settings and requirements for each.

    Each log has a folder of its own under the output. Logs whose maps are finished are not done
    again, a build that was killed goes on where it stopped, and a broken log does not stop the
    others.
    Exit code 2 where a log gave no map, 4 where a requirement is not met, 3 for partial maps.

    \b
    mapmyworld batch recordings
    mapmyworld batch logs.toml -o maps --jobs 4
    mapmyworld batch logs.toml -o s3://robots/maps --scheduler tcp://cluster:8786

    \b
    [defaults]                          # for all logs; every line may be left out
    require = ["nodes >= 10"]           # what `mapmyworld check --keys` lists
    set = { "mapping.resolution" = 0.05 }

    \b
    [[log]]
    log = "monday.bag"                  # or a list of parts, or a URL such as s3://...

    \b
    [[log]]
    name = "tuesday-again"
    log = "s3://robots/tuesday.mcap"
    method = "fastslam"
    reference = "tuesday.tum"
    require = ["ate_rmse <= 0.1"]
    """
    from cli.batching.job import finished
    from cli.batching.manifest import jobs_of_folder, read_manifest
    from cli.batching.runners import run_here, run_on_cluster
    from cli.batching.summary import as_json, as_text, exit_code

    jobs = jobs_of_folder(manifest) if manifest.is_dir() else read_manifest(manifest)
    place = _place(output)
    known = {} if again else {j.name: r for j in jobs if (r := finished(j, place)) is not None}
    waiting = [job for job in jobs if job.name not in known]
    if known:
        note(f"{len(known)} of {len(jobs)} logs are finished already")
    if scheduler is None:
        results_as_they_come = run_here(waiting, place, at_once)
    else:
        results_as_they_come = run_on_cluster(waiting, place, scheduler)
    with closing(results_as_they_come) as running:
        for result in running:
            known[result.name] = result
            reported = result.message.splitlines()[0] if result.message else result.status
            note(f"[{len(known)}/{len(jobs)}] {result.name}: {reported}")
    results = [known[job.name] for job in jobs]
    _write_summaries(results, place)
    show_result(as_json(results), as_text(results).splitlines())
    sys.exit(exit_code(results))


def _place(output: str) -> str:
    from cli.batching.urls import is_url

    if is_url(output):
        return output.rstrip("/")
    folder = Path(output).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    return str(folder)


def _write_summaries(results: Sequence[Result], place: str) -> None:
    from cli.batching.summary import FORMS
    from cli.batching.urls import delivered, is_url
    from formats.whole_files import write_whole

    with tempfile.TemporaryDirectory(prefix="mapmyworld-batch-") as scratch:
        folder = Path(scratch if is_url(place) else place)
        for name, form in FORMS.items():
            write_whole(folder / name, form(results))
        if is_url(place):
            delivered([folder / name for name in FORMS], place)
