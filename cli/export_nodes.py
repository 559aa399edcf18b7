"""`mapmyworld export trajectory`, `graph`, `images`, `vocabulary`; `report`, `figure`, `mcap`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from cli.arguments import PATH, map_argument
from cli.export_options import open_map, output_option, output_or, show_written
from mapmyworld.errors import MapError


@click.command()
@map_argument
@output_option("FILE", "[default: the map's name with the style's ending]")
@click.option("--style", type=click.Choice(["tum", "kitti", "csv"]), default="tum")
@click.option(
    "--which",
    type=click.Choice(["optimised", "odometry"]),
    default="optimised",
    help="Poses of all tracked frames: final ones, or the recorded odometry.",
)
def trajectory(map_path: Path, output: Path | None, style: Any, which: Any) -> None:
    """The trajectory as TUM, KITTI or CSV. TUM is for evo; CSV has integer nanoseconds.

    \b
    mapmyworld export trajectory
    mapmyworld export trajectory office.db --style csv --which odometry -o odometry.csv
    """
    from mapmyworld.exporting import export_trajectory

    ending = {"tum": ".tum", "kitti": ".kitti", "csv": ".csv"}[style]
    path = output_or(map_path, output, lambda: map_path.with_suffix(ending))
    with open_map(map_path, path) as store:
        show_written(export_trajectory(store, path, style, which), store)


@click.command()
@map_argument
@output_option("FILE.g2o", "[default: the map's name with .g2o]")
def graph(map_path: Path, output: Path | None) -> None:
    """The pose graph as g2o text. Accepted constraints and solved poses.

    \b
    mapmyworld export graph
    mapmyworld export graph office.db -o office.g2o
    """
    from formats.graph_files import write_graph
    from mapmyworld.exporting import graph_of

    path = output_or(map_path, output, lambda: map_path.with_suffix(".g2o"))
    with open_map(map_path, path) as store:
        write_graph(path, graph_of(store))
        show_written([path], store)


@click.command()
@map_argument
@output_option("FOLDER", "[default: the map's name with _images]")
@click.option(
    "--names",
    type=click.Choice(["stamp", "id"]),
    default="stamp",
    help="Name files by stamp or by node.",
)
def images(map_path: Path, output: Path | None, names: Any) -> None:
    """Images, calibration and poses of all nodes. Laid out as a TUM RGB-D folder.

    \b
    mapmyworld export images
    mapmyworld export images rtabmap.db -o pictures --names id
    """
    from formats.image_folders import write_images
    from mapmyworld.exporting import node_items

    folder = output or map_path.with_name(map_path.stem + "_images")
    with open_map(map_path) as store:
        show_written([folder], store, write_images(folder, node_items(store), names))


@click.command()
@map_argument
@output_option("FILE", "A text file.  [default: the map's name with .words.txt]")
def vocabulary(map_path: Path, output: Path | None) -> None:
    """The visual words, for other maps to use. The setting places.vocabulary names the file.

    \b
    mapmyworld export vocabulary office.db -o office.words.txt
    mapmyworld build next.mcap --set places.vocabulary=office.words.txt
    """
    from formats.vocabulary_files import write_vocabulary

    path = output_or(map_path, output, lambda: map_path.with_suffix(".words.txt"))
    with open_map(map_path, path) as store:
        write_vocabulary(path, store.words())
        show_written([path], store)


@click.command()
@map_argument
@output_option("FILE.html", "[default: the map's name with .html]")
def report(map_path: Path, output: Path | None) -> None:
    """The report, one self-contained HTML page. Map, graph, what was accepted or rejected, and why.

    \b
    mapmyworld export report
    mapmyworld export report office.db -o office.html
    """
    from cli.report import write_report

    path = output_or(map_path, output, lambda: map_path.with_suffix(".html"))
    with open_map(map_path, path) as store:
        write_report(store, path)
        show_written([path], store)


@click.command()
@map_argument
@click.option(
    "--what",
    type=click.Choice(["map", "graph", "loops", "uncertainty", "timing"]),
    default="map",
    help="Grid and path; all constraints; scans of closures; sigma over time; cost of the build.",
)
@output_option("FILE", "A .png, .svg or .pdf file.  [default: the map's name with _WHAT.png]")
def figure(map_path: Path, what: str, output: Path | None) -> None:
    """One picture for a paper or a pull request.

    \b
    mapmyworld export figure --what graph -o graph.svg
    mapmyworld export figure office.db --what loops -o loops.pdf
    """
    from cli.report import report_contents
    from formats.report.paper_figures import write_figure

    path = output_or(map_path, output, lambda: map_path.with_name(f"{map_path.stem}_{what}.png"))
    with open_map(map_path, path) as store:
        write_figure(path, what, report_contents(store))
        show_written([path], store)


@click.command()
@map_argument
@output_option("FILE.mcap", "[default: the map's name with .foxglove.mcap]")
@click.option(
    "--with-log",
    "logs",
    multiple=True,
    type=PATH,
    metavar="LOG",
    help="Copy this log too, with `map -> odom` added: it replays in the corrected frame.",
)
def mcap(map_path: Path, output: Path | None, logs: tuple[Path, ...]) -> None:
    """The map for Foxglove, and a layout beside it. Grid, cloud, path, poses, graph, images, tf.

    \b
    mapmyworld export mcap
    mapmyworld export mcap map.db -o replay.mcap --with-log drive.mcap
    """
    from cli.foxglove import export_mcap

    path = output_or(map_path, output, lambda: map_path.with_suffix(".foxglove.mcap"))
    beside = path.with_suffix(".layout.json")
    with open_map(map_path, path, beside, logs=logs) as store:
        if path.suffix != ".mcap":
            raise MapError(f"{path}: give a name that ends in .mcap")
        written, losses = export_mcap(store, path, logs)
        show_written(written, store, losses)
