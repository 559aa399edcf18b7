"""`mapmyworld inspect node`: one node, its sensors, its constraints, its picture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from cli.arguments import PATH, format_option, map_and
from cli.manners import note
from cli.outputs import require_outputs
from cli.standard_streams import show_result
from formats.database import open_store
from mapmyworld.errors import MapError
from mapmyworld.geometry.planar import matrix_to_planar
from mapmyworld.types import Judged, MapStore, Node, NodeData
from mapmyworld.types.wording import reason_of


@click.command("node")
@click.argument("arguments", metavar="[MAP] ID", nargs=-1, required=True)
@click.option(
    "--image",
    "image_path",
    type=PATH,
    help="Draw the node's image with its features into this PNG.",
)
@format_option
def node(arguments: tuple[str, ...], image_path: Path | None) -> None:
    """One node: pose, sigma, sensors, its constraints and their verdicts.

    \b
    mapmyworld inspect node 17
    mapmyworld inspect node office.db 17 --image node17.png
    """
    map_path, number = map_and(arguments, "a node's number")
    try:
        node_id = int(number)
    except ValueError:
        raise click.UsageError("give [MAP] and a node's number") from None
    require_outputs([image_path], [map_path])
    with open_store(map_path, read_only=True) as store:
        found = {n.id: n for n in store.nodes()}.get(node_id)
        if found is None:
            raise MapError(f"{map_path}: there is no node {node_id}; it has {len(store.nodes())}")
        data = store.node_data(node_id)
        facts = _facts(store, found, data)
        if image_path is not None:
            _draw(data, image_path)
    show_result(facts, _lines(facts))


def _facts(store: MapStore, node: Node, data: NodeData) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "id": node.id,
        "session": node.session,
        "stamp_s": node.stamp_ns * 1e-9,
        "odometry": matrix_to_planar(node.odom_from_base).tolist(),
        "sensors": _sensors(data),
        "constraints": [
            _constraint(c, node.id) for c in store.constraints() if node.id in {c.from_id, c.to_id}
        ],
    }
    poses = store.poses()
    if poses is not None and node.id in poses.ids:
        index = int(np.flatnonzero(poses.ids == node.id)[0])
        facts["pose"] = matrix_to_planar(poses.map_from_node[index]).tolist()
        facts["height_m"] = float(poses.map_from_node[index][2, 3])
        if poses.covariances is not None:
            sigma = np.sqrt(np.maximum(np.diag(poses.covariances[index]), 0.0))
            facts["sigma_xyz_m"], facts["sigma_rpy_rad"] = sigma[3:].tolist(), sigma[:3].tolist()
    return facts


def _sensors(data: NodeData) -> dict[str, str]:
    found: dict[str, str] = {}
    if data.scan is not None:
        found["scan"] = f"{len(data.scan.points)} returns, {len(data.scan.missing)} without"
    for index, image in enumerate(data.images):
        parts = [part for part in (image.colour, image.depth) if part is not None]
        text = " + ".join(p.encoding for p in parts)
        found[f"camera {index}"] = f"{image.camera.width}x{image.camera.height}, {text}"
    if data.cloud is not None:
        found["cloud"] = f"{len(data.cloud)} points"
    if data.features is not None:
        words = 0 if data.features.words is None else int((data.features.words > 0).sum())
        found["features"] = f"{len(data.features.pixels)}, {words} of them words"
    return found


def _constraint(constraint: Judged, node_id: int) -> dict[str, Any]:
    other = constraint.to_id if constraint.from_id == node_id else constraint.from_id
    return {
        "with": other,
        "kind": str(constraint.kind),
        "accepted": constraint.accepted,
        "reason": reason_of(constraint),
        "source": type(constraint.source).__name__,
        "evidence": asdict(constraint.source),
        "verdicts": [asdict(verdict) for verdict in constraint.verdicts],
    }


def _draw(data: NodeData, path: Path) -> None:
    colour = data.images[0].colour if data.images else None
    if colour is None:
        raise MapError(f"{path}: this node has no image to draw")
    from formats.report.match_picture import write_features_picture
    from mapmyworld.places.node_features import features_of_camera

    picture = np.asarray(colour.pixels(), np.uint8)
    seen = data.features and features_of_camera(data.features, 0, picture.shape[1])
    write_features_picture(path, picture, seen)
    note(f"drew {path}")


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [f"node {facts['id']} of session {facts['session']}, stamp {facts['stamp_s']:.6f}"]
    if "pose" in facts:
        x, y, yaw = facts["pose"]
        lines.append(f"pose:        x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.2f} deg")
    if "sigma_xyz_m" in facts:
        sigma, turn = facts["sigma_xyz_m"], np.degrees(facts["sigma_rpy_rad"][2])
        lines.append(f"sigma:       x {sigma[0]:.4f} m, y {sigma[1]:.4f} m, yaw {turn:.3f} deg")
    lines += [f"{name + ':':<12} {text}" for name, text in facts["sensors"].items()]
    lines.append("constraints:")
    for c in facts["constraints"]:
        verdict = "accepted" if c["accepted"] else "REJECTED"
        lines.append(f"  {c['kind']:<13} with {c['with']:<6} {verdict}: {c['reason']}")
    return lines
