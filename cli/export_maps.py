"""`mapmyworld export grid`, `cloud` and `mesh`: what the environment looks like."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.arguments import FiniteRange, map_argument
from cli.config import config_options
from cli.exit_codes import EXIT_CHECK_FAILED
from cli.export_options import open_map, output_option, output_or, show_written
from cli.outputs import require_utf8

if TYPE_CHECKING:
    from mapmyworld.config import Config


@click.command()
@map_argument
@output_option("STEM", "Writes STEM.pgm and STEM.yaml.  [default: the map's name]")
@click.option("--resolution", type=FiniteRange(min=0.001), metavar="M", help="Cell size [m].")
@click.option(
    "--mode",
    type=click.Choice(["trinary", "scale", "raw"]),
    default="trinary",
    help="Occupied/free/unknown; or probabilities as PNG with alpha; or as raw values.",
)
@click.option(
    "--verify",
    is_flag=True,
    help="Read them back by map_server's rules; exit code 4 if they differ.",
)
@config_options
def grid(
    map_path: Path,
    output: Path | None,
    resolution: float | None,
    mode: Any,
    verify: bool,
    config: Config,
) -> None:
    """The occupancy grid as PGM + YAML. Nav2 and map_server load it.

    \b
    mapmyworld export grid
    mapmyworld export grid office.db -o maps/office --resolution 0.025
    """
    from formats.grid_files import grid_files, same_grid, write_grid
    from mapmyworld.exporting import grid_at

    stem = output_or(map_path, output, lambda: map_path.with_suffix(""))
    stem = stem.with_suffix("") if stem == output and stem.suffix in _GRIDS else stem
    require_utf8(stem)
    with open_map(map_path, *grid_files(stem, mode)) as store:
        made = grid_at(store, config, resolution)
        written = write_grid(stem, made, mode)
        if verify and (differing := same_grid(written[1], made, mode)):
            message = f"mapmyworld: {written[1]}: {differing} cells read back differently"
            click.echo(message, err=True)
            sys.exit(EXIT_CHECK_FAILED)
        show_written(written, store)


_GRIDS = (".pgm", ".yaml", ".png")


@click.command()
@map_argument
@output_option("FILE", "A .ply or .pcd file.  [default: the map's name with .ply]")
@click.option("--voxel", type=FiniteRange(min=0.001), metavar="M", help="Voxel size [m].")
@click.option("--max-range", type=FiniteRange(min=0.1), metavar="M", help="Maximum depth [m].")
@config_options
def cloud(
    map_path: Path,
    output: Path | None,
    voxel: float | None,
    max_range: float | None,
    config: Config,
) -> None:
    """The coloured point cloud of all depth images. Of planar scans where there is no depth.

    \b
    mapmyworld export cloud
    mapmyworld export cloud office.db -o office.pcd --voxel 0.05
    """
    from mapmyworld.config.settings import apply_settings
    from mapmyworld.exporting import export_cloud, export_scan_cloud

    given = {"visual.cloud_voxel": voxel, "visual.cloud_range": max_range}
    config = apply_settings(config, {k: v for k, v in given.items() if v is not None})
    path = output_or(map_path, output, lambda: map_path.with_suffix(".ply"))
    with open_map(map_path, path) as store:
        written = export_cloud(store, path, config) or export_scan_cloud(store, path, config)
        show_written(written, store)


@click.command()
@map_argument
@output_option("FILE", "A .ply file.  [default: the map's name with _mesh.ply]")
@config_options
def mesh(
    map_path: Path,
    output: Path | None,
    config: Config,
) -> None:
    """A coloured triangle mesh of all depth images. Needs Open3D and its system libraries.

    \b
    mapmyworld export mesh
    mapmyworld export mesh office.db -o office.ply
    """
    from formats.cloud_files import write_mesh
    from mapmyworld.exporting import nodes_with_poses
    from mapmyworld.mapping.mesh_map import build_mesh

    path = output_or(map_path, output, lambda: map_path.with_name(map_path.stem + "_mesh.ply"))
    with open_map(map_path, path) as store:
        made = build_mesh(nodes_with_poses(store), config)
        write_mesh(path, made)
        show_written([path], store)
