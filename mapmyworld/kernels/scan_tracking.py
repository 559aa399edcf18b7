"""Scans followed one after the other, as long as nothing is odd about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.laser_motion import (
    between_poses,
    leaves_open,
    motion_variances,
    step_covariance,
    surprise_of,
    wrapped,
)
from mapmyworld.kernels.scan_alignment import Rows, align

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_MEMORY = 0.95  # weight of the past in the running mean of squared surprises
_MOVES = 0.01  # m and rad from which a frame's motion tells about odometry
_LARGEST = 400.0  # squared sigmas that one step may teach
_WELL_EXPLAINED = 0.75  # overlap below which a scan joins the submap sooner
_SOONER = 0.3  # of the motion after which others do


@jit
def learnt_scale(scale: float, recorded: Array, moved: Array, surprise: float) -> float:
    """The factor on the odometry's variances after one more surprise (squared sigmas)."""
    squared = min(surprise / 3.0 * scale, _LARGEST)
    for i in range(3):
        if max(abs(moved[i]), abs(recorded[i])) > _MOVES:
            return max(_MEMORY * scale + (1.0 - _MEMORY) * squared, 1.0)
    return scale


@jit
def remember_scan(
    rows: Rows, origin: Array, pose: Array, overlap: float, distance: float, angle: float,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    keys: Index,
) -> None:  # fmt: skip
    """Lets a scan join the submap, a ring of keyscans, where it says something new.

    `keys` holds the slot of the newest keyscan and how many there are.
    """
    slots = len(key_counts)
    if keys[1] > 0:
        step = between_poses(key_poses[keys[0]], pose)
        near = 1.0 if overlap > _WELL_EXPLAINED else _SOONER
        if np.hypot(step[0], step[1]) < near * distance and abs(step[2]) < near * angle:
            return
    slot = (keys[0] + 1) % slots
    # Number by number: numba's assignment of slices takes seconds to compile.
    for i in range(len(rows)):
        for j in range(5):
            key_rows[slot, i, j] = rows[i, j]
    key_counts[slot] = len(rows)
    key_origins[slot, 0], key_origins[slot, 1] = origin[0], origin[1]
    for i in range(3):
        key_poses[slot, i] = pose[i]
    keys[0], keys[1] = slot, min(keys[1] + 1, slots)


@jit
def chosen_keyscans(back: Index, keys: Index, slots: int) -> Index:
    """Slots of the keyscans that lie so many places back in the ring."""
    found = np.empty(len(back), np.int64)
    count = 0
    for b in back:
        if b <= keys[1]:
            found[count] = (keys[0] - b + 1) % slots
            count += 1
    return found[:count]


@inner_jit
def match_keyscans(
    rows: Rows, first: int, last: int,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    which: Index, predicted: Array, known: Array, reaches: Array, settings: Array,
    out: Array, information: Array,
) -> None:  # fmt: skip
    """Aligns a scan with keyscans; fills `out` as `align` does, and the match's information.

    `known` (3, 3) is the information of the predicted pose; `settings` are those of `track_scans`.
    """
    capacity = key_rows.shape[1]
    starts, ends = np.empty(len(key_counts), np.int64), np.empty(len(key_counts), np.int64)
    for k in range(len(key_counts)):
        starts[k], ends[k] = k * capacity, k * capacity + key_counts[k]
    align(
        rows, first, last, key_rows.reshape(-1, 5), starts, ends, which, key_poses,
        key_origins, predicted, predicted, known, reaches, settings[0],
        settings[1] * np.sqrt(settings[2]), out,
    )  # fmt: skip
    variance = max(settings[1] * settings[1], out[10]) * settings[2]
    slot = 3
    for i in range(3):
        for j in range(i, 3):
            value = out[slot] / (variance * max(len(which), 1))
            information[i, j] = information[j, i] = value
            slot += 1


@inner_jit
def gone_on(state: Array, step: Array, predicted: Array) -> None:
    """Fills where a step from the state's pose leads to."""
    c, s = np.cos(state[2]), np.sin(state[2])
    predicted[0] = state[0] + c * step[0] - s * step[1]
    predicted[1] = state[1] + s * step[0] + c * step[1]
    predicted[2] = wrapped(state[2] + step[2])


@inner_jit
def weigh_step(
    state: Array, step: Array, predicted: Array, pose: Array, moved: Array, surprise: float,
    information: Array, variances: Array, settings: Array, covariance: Array,
) -> None:  # fmt: skip
    """Fills the covariance (3, 3) of a matched step; odometry's scale learns from it.

    Where the two disagree, neither is sure. Without odometry `step` is NaN.
    """
    doubt = np.zeros(3)
    if not np.isnan(step[0]):
        state[6] = learnt_scale(state[6], step, moved, surprise)
        if surprise > settings[9]:
            apart = between_poses(predicted, pose)
            for i in range(3):
                doubt[i] = apart[i] * apart[i]
    found = step_covariance(moved, information, variances, doubt, settings[7], settings[8])
    for i in range(3):
        for j in range(3):
            covariance[i, j] = found[i, j]


@jit
def track_scans(
    start: int,
    rows: Rows,
    bounds: Index,
    origins: Array,
    recorded: Array,
    key_rows: NDArray[np.float32],
    key_counts: Index,
    key_origins: Array,
    key_poses: Array,
    keys: Index,
    back: Index,
    state: Array,
    reaches: Array,
    settings: Array,
    fewest: int,
    out: Array,
    covariances: Array,
) -> int:
    """Follows scans from `start` on; the index of the first that needs a closer look.

    `recorded` (B, 3) are odometry's steps, NaN where there is none; `state` (7,) is the pose, the
    last step and the scale of the odometry's variances; `settings` are residual share, sigma of a
    range, correlation, share and floor of the motion model, limits of surprise and overlap,
    keyscan distance and angle, surprise from which neither motion is sure. Fills `out` (B, 7):
    pose, overlap, surprise, metres moved, weak (1 or 0); and `covariances` (B, 3, 3) of the steps.
    """  # fmt: skip
    found, predicted, pose = np.zeros(16), np.empty(3), np.empty(3)
    information, known = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(start, len(bounds) - 1):
        if bounds[k + 1] - bounds[k] < fewest or keys[1] == 0:
            return k
        has_odometry = not np.isnan(recorded[k, 0])
        if has_odometry:
            gone_on(state, recorded[k], predicted)
            variances = motion_variances(recorded[k], settings[3], settings[4], state[6])
        else:
            gone_on(state, state[3:6], predicted)
            variances = motion_variances(state[3:6], 1.0, 0.1, 1.0)
        for i in range(3):
            known[i, i] = 1.0 / variances[i]
        which = chosen_keyscans(back, keys, len(key_counts))
        match_keyscans(
            rows, bounds[k], bounds[k + 1], key_rows, key_counts, key_origins, key_poses, which,
            predicted, known, reaches, settings, found, information,
        )  # fmt: skip
        for i in range(3):
            pose[i] = found[i]
        surprise = surprise_of(predicted, pose, information, variances)
        if surprise > settings[5] or found[9] < settings[6]:
            return k
        moved = between_poses(state, pose)
        weigh_step(
            state, recorded[k], predicted, pose, moved, surprise, information, variances,
            settings, covariances[k],
        )  # fmt: skip
        for i in range(3):
            out[k, i], state[i], state[3 + i] = pose[i], pose[i], moved[i]
        out[k, 3], out[k, 4], out[k, 5] = found[9], surprise, np.hypot(moved[0], moved[1])
        out[k, 6] = 1.0 if leaves_open(information) else 0.0
        remember_scan(
            rows[bounds[k] : bounds[k + 1]], origins[k], pose, found[9], settings[7], settings[8],
            key_rows, key_counts, key_origins, key_poses, keys,
        )  # fmt: skip
    return len(bounds) - 1
