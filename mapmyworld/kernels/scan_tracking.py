"""Scans followed one after the other, as long as nothing is odd about them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
_WELL_EXPLAINED = 0.75  # overlap below which a scan joins the submap even if near the last one


@njit(cache=True, nogil=True)
def learnt_scale(scale: float, recorded: Array, moved: Array, surprise: float) -> float:
    """The factor on the odometry's variances after one more surprise (squared sigmas)."""
    squared = min(surprise / 3.0 * scale, _LARGEST)
    if max(np.abs(moved).max(), np.abs(recorded).max()) > _MOVES:
        return max(_MEMORY * scale + (1.0 - _MEMORY) * squared, 1.0)
    return scale


@njit(cache=True, nogil=True)
def remember_scan(
    rows: Rows, origin: Array, pose: Array, overlap: float, distance: float, angle: float,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    keys: Index,
) -> None:  # fmt: skip
    """Lets a scan join the submap, a ring of keyscans, where it says something new.

    `keys` holds the slot of the newest keyscan and how many there are.
    """
    slots = len(key_counts)
    if keys[1] > 0 and overlap > _WELL_EXPLAINED:
        step = between_poses(key_poses[keys[0]], pose)
        if np.hypot(step[0], step[1]) < distance and abs(step[2]) < angle:
            return
    slot = (keys[0] + 1) % slots
    key_rows[slot, : len(rows)] = rows
    key_counts[slot] = len(rows)
    key_origins[slot], key_poses[slot] = origin, pose
    keys[0], keys[1] = slot, min(keys[1] + 1, slots)


@njit(cache=True, nogil=True)
def chosen_keyscans(back: Index, keys: Index, slots: int) -> Index:
    """Slots of the keyscans that lie so many places back in the ring."""
    found = np.empty(len(back), np.int64)
    count = 0
    for b in back:
        if b <= keys[1]:
            found[count] = (keys[0] - b + 1) % slots
            count += 1
    return found[:count]


@njit(cache=True, nogil=True)
def match_keyscans(
    rows: Rows, first: int, last: int,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    which: Index, guess: Array, prior: Array, prior_information: Array, reaches: Array,
    scale: float, range_sigma: float, correlation: float, out: Array, information: Array,
) -> None:  # fmt: skip
    """Aligns a scan with keyscans; fills `out` as `align` does, and the match's information."""
    capacity = key_rows.shape[1]
    starts = np.arange(len(key_counts)) * capacity
    align(
        rows, first, last, key_rows.reshape(-1, 5), starts, starts + key_counts, which, key_poses,
        key_origins, guess, prior, prior_information, reaches, scale,
        range_sigma * np.sqrt(correlation), out,
    )  # fmt: skip
    variance = max(range_sigma * range_sigma, out[10]) * correlation
    slot = 3
    for i in range(3):
        for j in range(i, 3):
            value = out[slot] / (variance * max(len(which), 1))
            information[i, j] = information[j, i] = value
            slot += 1


@njit(cache=True, nogil=True)
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
    last step and the scale of the odometry's variances; `settings` are residual scale, sigma of a
    range, correlation, share and floor of the motion model, limits of surprise and overlap,
    keyscan distance and angle, surprise from which neither motion is sure. Fills `out` (B, 8):
    pose, overlap, surprise, metres moved, weak (1 or 0), largest position sigma; and
    `covariances` (B, 3, 3) of the steps.
    """  # fmt: skip
    found = np.zeros(16)
    information, prior_information = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(start, len(bounds) - 1):
        if bounds[k + 1] - bounds[k] < fewest or keys[1] == 0:
            return k
        has_odometry = not np.isnan(recorded[k, 0])
        step = recorded[k] if has_odometry else state[3:6]
        predicted = np.empty(3)
        c, s = np.cos(state[2]), np.sin(state[2])
        predicted[0] = state[0] + c * step[0] - s * step[1]
        predicted[1] = state[1] + s * step[0] + c * step[1]
        predicted[2] = wrapped(state[2] + step[2])
        if has_odometry:
            variances = motion_variances(step, settings[3], settings[4], state[6])
        else:
            variances = motion_variances(step, 1.0, 0.1, 1.0)
        for i in range(3):
            prior_information[i, i] = 1.0 / variances[i]
        which = chosen_keyscans(back, keys, len(key_counts))
        match_keyscans(
            rows, bounds[k], bounds[k + 1], key_rows, key_counts, key_origins, key_poses, which,
            predicted, predicted, prior_information, reaches, settings[0], settings[1],
            settings[2], found, information,
        )  # fmt: skip
        pose, overlap = found[:3].copy(), found[9]
        surprise = surprise_of(predicted, pose, information, variances)
        if surprise > settings[5] or overlap < settings[6]:
            return k
        moved = between_poses(state[:3], pose)
        doubt = np.zeros(3)
        if has_odometry:
            state[6] = learnt_scale(state[6], step, moved, surprise)
            if surprise > settings[9]:
                doubt = between_poses(predicted, pose) ** 2
        covariances[k] = step_covariance(
            moved, information, variances, doubt, settings[7], settings[8]
        )
        out[k, :3], out[k, 3], out[k, 4] = pose, overlap, surprise
        out[k, 5] = np.hypot(moved[0], moved[1])
        out[k, 6] = 1.0 if leaves_open(information) else 0.0
        state[:3], state[3:6] = pose, moved
        remember_scan(
            rows[bounds[k] : bounds[k + 1]], origins[k], pose, overlap, settings[7], settings[8],
            key_rows, key_counts, key_origins, key_poses, keys,
        )  # fmt: skip
    return len(bounds) - 1
