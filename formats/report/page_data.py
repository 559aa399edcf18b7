"""The values that the page's script works with, as plain JSON: short keys, rounded numbers."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formats.report.contents import ReportContents
from mapmyworld.types import ConstraintKind, PointCloud

_CLOUD_POINTS = 60_000  # that are shown
_FINE = 32767


def page_data(contents: ReportContents) -> dict[str, Any]:
    """Nodes, path, constraints and where their evidence stands."""
    nodes = contents.nodes
    return {
        "nodes": {
            "id": nodes.ids.tolist(),
            "t": _rounded(nodes.times_s, 2),
            "x": _rounded(nodes.places[:, 0], 3),
            "y": _rounded(nodes.places[:, 1], 3),
            "yaw": _rounded(nodes.places[:, 2], 3),
            "sigma": None if nodes.sigmas_m is None else _rounded(nodes.sigmas_m, 4),
            "session": nodes.sessions.tolist() if nodes.sessions.any() else None,
        },
        "path": _rounded(contents.path[:: max(1, len(contents.path) // 6000)], 2),
        "pictures": {str(k): [p.width, p.height] for k, p in contents.pictures.items()},
        "cards": [item.index for item in contents.evidence],
        **_constraints(contents),
    }


def _constraints(contents: ReportContents) -> dict[str, Any]:
    """One row a constraint; reasons and kinds as places in lists."""
    kinds, reasons = [str(kind) for kind in ConstraintKind], {"": 0}
    rows = []
    for c in contents.constraints:
        # How each step of the path was matched would be the bulk of the page.
        reason = "" if c.kind == ConstraintKind.NEIGHBOUR and c.accepted else c.reason
        given = c.residual or (np.nan,) * 3
        residual = [float(f"{v:.4g}") if np.isfinite(v) else None for v in given]
        rows.append(
            [
                c.from_id,
                c.to_id,
                kinds.index(str(c.kind)),
                int(c.accepted),
                *residual,
                reasons.setdefault(reason, len(reasons)),
            ]
        )
    return {"kinds": kinds, "reasons": list(reasons), "constraints": rows}


def _rounded(values: NDArray[np.float64], digits: int) -> Any:
    return np.round(np.nan_to_num(values), digits).tolist()


def cloud_data(cloud: PointCloud | None) -> dict[str, Any] | None:
    """Points as 16-bit steps within their box, and colours."""
    if cloud is None or len(cloud.points) == 0:
        return None
    step = -(-len(cloud.points) // _CLOUD_POINTS)
    points = cloud.points[::step].astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    unit = max(float((high - low).max()), 1e-6) / _FINE
    places = np.round((points - low) / unit).astype("<u2")
    colours = None if cloud.colours is None else cloud.colours[::step].astype(np.uint8)
    return {
        "low": np.round(low, 4).tolist(),
        "unit": unit,
        "points": base64.b64encode(places.tobytes()).decode(),
        "colours": None if colours is None else base64.b64encode(colours.tobytes()).decode(),
        "count": len(places),
        "of": len(cloud.points),
    }
