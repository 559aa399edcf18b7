"""What a node keeps, as a row of RTAB-Map's Data table, both ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from formats.database import feature_rows
from formats.database.blobs import blob_to_matrix
from formats.database.calibration import blob_to_eyes, camera_record
from formats.database.connection import Connection, Row
from formats.database.node_rows import StorageOptions
from formats.database.scan_blobs import cloud_to_columns, columns_to_observation, scan_to_columns
from formats.nested_text import json_from_text
from mapmyworld.errors import MapError
from mapmyworld.types import NodeData

INSERT_DATA = (
    "INSERT INTO Data (id, image, depth, calibration, scan, scan_info) VALUES (?,?,?,?,?,?)"
)
SELECT_DATA = "SELECT image, depth, calibration, scan, scan_info FROM Data WHERE id = ?"


def data_row(node_id: int, data: NodeData, options: StorageOptions) -> Row | None:
    """RTAB-Map's row of a node's data; None where there are none."""
    images = data.images if options.store_images else ()
    if not images and data.scan is None and data.cloud is None:
        return None
    scan: tuple[bytes | None, bytes | None] = (None, None)
    pictures = scan
    if data.scan is not None:
        scan = scan_to_columns(data.scan)
    elif data.cloud is not None:
        scan = cloud_to_columns(data.cloud)
    if images:
        from formats.database.image_columns import colour_blob, depth_blob  # a codec takes 20 MB

        pictures = colour_blob(images, options), depth_blob(images, options)
    cameras = b"".join(camera_record(image.camera) for image in images)
    return (node_id, *pictures, cameras or None, *scan)


def node_data(
    db: Connection, node_id: int, row: Row | None, own: Row | None, stamp_ns: int, features: bool
) -> NodeData:
    """The data of a row of `SELECT_DATA`, with the node's features where they are wanted.

    `own`: scan_rest, image_stamps and cloud of our own table, None in a file
    of RTAB-Map's.

    Raises `MapError` where they are damaged.
    """
    what = f"{db.path}: node {node_id}"
    data = _data(row or (None,) * 5, own, stamp_ns, what)
    if not features:
        return data
    found = db.rows(feature_rows.SELECT_FEATURES, (node_id,))
    return replace(data, features=feature_rows.features_from_rows(found, what))


def _data(row: Row, own: Row | None, stamp_ns: int, what: str) -> NodeData:
    image, depth, calibration, scan, scan_info = row
    rest, stamps, both = own or (None, None, None)
    if any(value is not None and not isinstance(value, bytes) for value in (*row, rest, both)):
        raise MapError(f"{what}: a column of its data is not a blob")
    eyes = blob_to_eyes(calibration, f"{what}'s calibration")
    planar, cloud = columns_to_observation(scan, scan_info, rest, f"{what}'s scan")
    if both is not None:
        matrix = blob_to_matrix(both, f"{what}'s cloud")
        cloud = None if matrix is None else np.asarray(matrix, np.float32).reshape(-1, 3)
    times = _times(stamps, what) if stamps else [stamp_ns] * max(len(eyes), 1)
    if not eyes:  # without a calibration there is nothing that the pixels could mean
        return NodeData(planar, (), cloud)
    from formats.database.image_columns import columns_to_images

    return NodeData(planar, columns_to_images(image, depth, eyes, times, what), cloud)


def _times(stamps: object, what: str) -> list[int]:
    """The moments of a node's images, as they were kept."""
    try:
        found = json_from_text(stamps) if isinstance(stamps, str) else None
    except ValueError:
        found = None
    if not isinstance(found, list) or not found or not all(type(time) is int for time in found):
        raise MapError(f"{what}: the stamps of its images are damaged")
    return found
