"""`mapmyworld export`: grids, clouds, meshes, trajectories, graphs, images, reports of a map."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from cli.common import EXIT_CHECK_FAILED, EXIT_PARTIAL, map_argument
from cli.settings import config_options, load_config
from mapmyworld.errors import MapError

if TYPE_CHECKING:
    from mapmyworld.config import Config

F = TypeVar("F", bound=Callable[..., Any])


class _Exports(click.Group):
    """Says in one line where a file cannot be written."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except OSError as error:
            place = error.filename or "the file"
            raise MapError(
                f"{place}: cannot be written ({error.strerror}): give another -o"
            ) from None


@click.group(cls=_Exports)
def export() -> None:
    """Write what a map holds as files that other programs read.

    \b
    mapmyworld export grid --resolution 0.025
    mapmyworld export trajectory office.db --style kitti
    mapmyworld export cloud rtabmap.db -o office.ply       (a database of RTAB-Map's)
    """


def _output(metavar: str, text: str) -> Callable[[F], F]:
    return click.option(
        "-o", "--output", metavar=metavar, type=click.Path(path_type=Path), help=text
    )


def _open(map_path: Path, *, read_only: bool = True) -> Any:
    from formats.database import open_store

    return open_store(map_path, read_only=read_only)


def _save_option(command: F) -> F:
    return click.option(
        "--save-in-map", is_flag=True, help="Also into MAP, for RTAB-Map's viewer to show."
    )(command)


def _tell(paths: Sequence[Path], store: Any) -> None:
    """Names what was written on stdout; what was left out, on stderr with exit code 3."""
    for path in paths:
        click.echo(str(path))
    if store.problems:
        for problem in store.problems:
            click.echo(f"mapmyworld: {problem}", err=True)
        sys.exit(EXIT_PARTIAL)


@export.command()
@map_argument
@_output("STEM", "Writes STEM.pgm and STEM.yaml.  [default: the map's name]")
@click.option("--resolution", type=click.FloatRange(min=0.001), metavar="M", help="Metres a cell.")
@click.option(
    "--mode",
    type=click.Choice(["trinary", "scale", "raw"]),
    default="trinary",
    show_default=True,
    help="Occupied/free/unknown; or probabilities as PNG with alpha; or as raw values.",
)
@click.option("--verify", is_flag=True, help="Read the files back by map_server's rules; exit 4.")
@config_options
def grid(
    map_path: Path,
    output: Path | None,
    resolution: float | None,
    mode: Any,
    verify: bool,
    config_path: Path | None,
    changes: tuple[str, ...],
) -> None:
    """The occupancy grid as PGM + YAML, as Nav2 and map_server load it.

    \b
    mapmyworld export grid
    mapmyworld export grid office.db -o maps/office --resolution 0.025
    """
    from cli.exporting import grid_at
    from formats.grid import write_grid

    config = load_config(config_path, changes)
    with _open(map_path) as store:
        made = grid_at(store, config, resolution)
        stem = output.with_suffix("") if output and output.suffix in _GRIDS else output
        written = write_grid(stem or map_path.with_suffix(""), made, mode)
        if verify:
            _verify(written[1], made, mode)
        _tell(written, store)


_GRIDS = (".pgm", ".yaml", ".png")


def _verify(path: Path, made: Any, mode: Any) -> None:
    """Ends with exit code 4 unless the files hold what we hold."""
    from formats.grid import same_grid

    differing = same_grid(path, made, mode)
    if differing:
        click.echo(f"mapmyworld: {path}: {differing} cells read back differently", err=True)
        sys.exit(EXIT_CHECK_FAILED)


@export.command()
@map_argument
@_output("FILE", "A .ply or .pcd file.  [default: the map's name with .ply]")
@click.option("--voxel", type=click.FloatRange(min=0.001), metavar="M", help="Metres a voxel.")
@click.option("--max-range", type=click.FloatRange(min=0.1), metavar="M", help="Depth used up to.")
@_save_option
@config_options
def cloud(
    map_path: Path,
    output: Path | None,
    voxel: float | None,
    max_range: float | None,
    save_in_map: bool,
    config_path: Path | None,
    changes: tuple[str, ...],
) -> None:
    """The coloured point cloud of all depth images; of planar scans where there is no depth.

    \b
    mapmyworld export cloud
    mapmyworld export cloud office.db -o office.pcd --voxel 0.05
    """
    from cli.exporting import export_cloud, export_scan_cloud
    from formats.cloud import read_cloud

    config = _for_cloud(load_config(config_path, changes), voxel, max_range)
    path = output or map_path.with_suffix(".ply")
    with _open(map_path, read_only=not save_in_map) as store:
        written = export_cloud(store, path, config) or export_scan_cloud(store, path, config)
        if save_in_map:
            store.set_cloud(read_cloud(path))
        _tell(written, store)


def _for_cloud(config: Config, voxel: float | None, max_range: float | None) -> Config:
    visual = config.visual
    if voxel is not None:
        visual = replace(visual, cloud_voxel=voxel)
    if max_range is not None:
        visual = replace(visual, cloud_range=max_range)
    return replace(config, visual=visual)


@export.command()
@map_argument
@_output("FILE", "A .ply file.  [default: the map's name with _mesh.ply]")
@_save_option
@config_options
def mesh(
    map_path: Path,
    output: Path | None,
    save_in_map: bool,
    config_path: Path | None,
    changes: tuple[str, ...],
) -> None:
    """A coloured triangle mesh of all depth images. Needs open3d and the libraries it needs.

    \b
    mapmyworld export mesh
    mapmyworld export mesh office.db -o office.ply
    """
    from cli.exporting import nodes_with_poses
    from formats.mesh import write_mesh
    from mapmyworld.mapping.mesh import build_mesh

    config = load_config(config_path, changes)
    path = output or map_path.with_name(map_path.stem + "_mesh.ply")
    with _open(map_path, read_only=not save_in_map) as store:
        made = build_mesh(nodes_with_poses(store), config)
        write_mesh(path, made)
        if save_in_map:
            store.set_mesh(made)
        _tell([path], store)


@export.command()
@map_argument
@_output("FILE", "[default: the map's name with the style's ending]")
@click.option(
    "--style", type=click.Choice(["tum", "kitti", "csv"]), default="tum", show_default=True
)
@click.option(
    "--which",
    type=click.Choice(["optimised", "odometry"]),
    default="optimised",
    show_default=True,
    help="Final poses of all tracked frames, or the recorded odometry of the nodes.",
)
def trajectory(map_path: Path, output: Path | None, style: Any, which: Any) -> None:
    """Where the robot was when: TUM (evo reads it), KITTI, or CSV with integer nanoseconds.

    \b
    mapmyworld export trajectory
    mapmyworld export trajectory office.db --style csv --which odometry -o odometry.csv
    """
    from cli.exporting import export_trajectory

    ending = {"tum": ".tum", "kitti": ".kitti", "csv": ".csv"}[style]
    path = output or map_path.with_suffix(ending)
    with _open(map_path) as store:
        _tell(export_trajectory(store, path, style, which), store)


@export.command()
@map_argument
@_output("FILE.g2o", "[default: the map's name with .g2o]")
def graph(map_path: Path, output: Path | None) -> None:
    """The pose graph as g2o text: accepted constraints and solved poses.

    \b
    mapmyworld export graph
    mapmyworld export graph office.db -o office.g2o
    """
    from cli.exporting import graph_of
    from formats.pose_graph import write_graph

    path = output or map_path.with_suffix(".g2o")
    with _open(map_path) as store:
        write_graph(path, graph_of(store))
        _tell([path], store)


@export.command()
@map_argument
@_output("FOLDER", "[default: the map's name with _images]")
@click.option(
    "--names", type=click.Choice(["stamp", "id"]), default="stamp", help="What files are called."
)
def images(map_path: Path, output: Path | None, names: Any) -> None:
    """Colour and depth images of all nodes with calibration and poses, laid out as TUM RGB-D.

    \b
    mapmyworld export images
    mapmyworld export images rtabmap.db -o pictures --names id
    """
    from cli.exporting import node_items
    from formats.images import write_images

    folder = output or map_path.with_name(map_path.stem + "_images")
    with _open(map_path) as store:
        written = write_images(folder, node_items(store), names)
        for problem in written.problems:
            click.echo(f"mapmyworld: {problem}", err=True)
        _tell([folder], store)
    if written.problems:
        sys.exit(EXIT_PARTIAL)


@export.command()
@map_argument
@_output("FILE", "A text file.  [default: the map's name with .words.txt]")
def vocabulary(map_path: Path, output: Path | None) -> None:
    """The visual words, for other maps to use: --set places.vocabulary=FILE.

    \b
    mapmyworld export vocabulary office.db -o office.words.txt
    mapmyworld build next.mcap --set places.vocabulary=office.words.txt
    """
    from formats.vocabulary import write_vocabulary

    path = output or map_path.with_suffix(".words.txt")
    with _open(map_path) as store:
        write_vocabulary(path, store.words())
        _tell([path], store)


@export.command()
@map_argument
@_output("FILE.html", "[default: the map's name with .html]")
@click.option(
    "--every-match", is_flag=True, help="Match the images of all closures again, not of 48."
)
def report(map_path: Path, output: Path | None, every_match: bool) -> None:
    """One self-contained HTML page: the map, the graph, what was accepted, rejected, and why.

    \b
    mapmyworld export report
    mapmyworld export report office.db -o office.html
    """
    from cli.report import write_report

    path = output or map_path.with_suffix(".html")
    with _open(map_path) as store:
        write_report(store, path, every_match=every_match)
        _tell([path], store)


@export.command()
@map_argument
@click.option(
    "--what",
    type=click.Choice(["map", "graph", "loops", "uncertainty", "timing"]),
    default="map",
    show_default=True,
    help="Grid and path; all constraints; scans of closures; sigma over time; cost of the build.",
)
@_output("FILE", "A .png, .svg or .pdf file.  [default: the map's name with _WHAT.png]")
def figure(map_path: Path, what: str, output: Path | None) -> None:
    """One picture for a paper or a pull request, without the page around it.

    \b
    mapmyworld export figure --what graph -o graph.svg
    mapmyworld export figure office.db --what loops -o loops.pdf
    """
    from cli.report import report_contents, timing_beside
    from formats.report.figures import write_figure

    path = output or map_path.with_name(f"{map_path.stem}_{what}.png")
    with _open(map_path) as store:
        write_figure(path, what, report_contents(store, timing_beside(store)))
        _tell([path], store)


@export.command()
@map_argument
@_output("FILE.mcap", "[default: the map's name with .foxglove.mcap]")
@click.option(
    "--with-log",
    "logs",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="LOG",
    help="Copy this log too, with `map -> odom` added: it replays in the corrected frame.",
)
def mcap(map_path: Path, output: Path | None, logs: tuple[Path, ...]) -> None:
    """The map for Foxglove: grid, cloud, path, poses, graph, images, tf; and a layout beside it.

    \b
    mapmyworld export mcap
    mapmyworld export mcap office.db -o office.mcap --with-log drive.bag
    """
    from cli.foxglove import export_mcap

    path = output or map_path.with_suffix(".foxglove.mcap")
    with _open(map_path) as store:
        written, losses = export_mcap(store, path, logs)
        for loss in losses:
            click.echo(f"mapmyworld: {loss}", err=True)
        _tell(written, store)
    if losses:
        sys.exit(EXIT_PARTIAL)
