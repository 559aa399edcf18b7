"""Where a robot was in a finished map, as CSV with states and as MCAP for viewers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from formats.decimal_stamps import seconds_text
from formats.recording_files import LogWriter
from formats.ros_messages import pose_in_map
from formats.whole_files import write_whole
from mapmyworld.geometry.planar import PLANAR_IN_TANGENT
from mapmyworld.geometry.rotations import rotation_to_quaternion
from mapmyworld.types import TextMessage, TransformsMessage, TransformStamped
from mapmyworld.types.localisation import Estimate, Localisation

_CORRECTION = tuple(f"correction_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))
_SIGMAS = ("sigma_x", "sigma_y", "sigma_yaw")
CSV_COLUMNS = (
    "stamp_ns", "time_s", "state", "known", "x", "y", "z", "qx", "qy", "qz", "qw", *_SIGMAS, "fit",
    *_CORRECTION,
)  # fmt: skip


def write_localisation_csv(path: Path, localisation: Localisation) -> None:
    """One row a moment; `sigma_*` in the robot's frame, `correction_*` is map_from_odom."""
    lines = [",".join(CSV_COLUMNS), *(_row(e) for e in localisation.estimates)]
    write_whole(path, ("\n".join(lines) + "\n").encode())


def _row(estimate: Estimate) -> str:
    sigmas = np.sqrt(np.diag(estimate.covariance)[PLANAR_IN_TANGENT])
    correction = estimate.map_from_odom
    shown = [""] * 7 if correction is None else _numbers(correction)
    return ",".join(
        [
            str(estimate.stamp_ns),
            seconds_text(estimate.stamp_ns),
            str(estimate.state),
            str(int(estimate.known)),
            *_numbers(estimate.map_from_base),
            *(f"{sigma:.6g}" for sigma in sigmas),
            f"{estimate.fit:.4f}",
            *shown,
        ]
    )


def _numbers(pose: NDArray[np.float64]) -> list[str]:
    values = [*pose[:3, 3].tolist(), *rotation_to_quaternion(pose[:3, :3]).tolist()]
    return [f"{value:z.9f}" for value in values]


def write_localisation_mcap(path: Path, localisation: Localisation, *, base_frame: str) -> None:
    """Known poses as /localisation/pose, states as /localisation/state, and tf.

    tf is `map -> odom` with the recorded `odom -> base` where the log has odometry, else
    `map -> base`; while the place is unknown there is none.
    """
    with LogWriter(path, overwrite=True) as writer:
        # In the order of the log: stamps may step back, the time of recording must not.
        time, state = 0, None
        for estimate in localisation.estimates:
            stamp_ns = estimate.stamp_ns
            time = max(time, stamp_ns)
            if estimate.state != state:
                state = estimate.state
                writer.write("/localisation/state", TextMessage(stamp_ns, str(state)), time)
            if estimate.known:
                correction, odometry = estimate.map_from_odom, estimate.odom_from_base
                links = [("map", base_frame, estimate.map_from_base)]
                if correction is not None and odometry is not None:
                    links = [("map", "odom", correction), ("odom", base_frame, odometry)]
                moved = tuple(TransformStamped(stamp_ns, *link) for link in links)
                writer.write("/tf", TransformsMessage(moved, False), time)
                place = pose_in_map(stamp_ns, estimate.map_from_base, estimate.covariance)
                writer.write("/localisation/pose", place, time)
