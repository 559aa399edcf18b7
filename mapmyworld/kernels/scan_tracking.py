"""Scans followed one after the other, as long as nothing is odd about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.geometry import Array, Index
from mapmyworld.kernels.compiling import inner_jit, jit
from mapmyworld.kernels.laser_motion import (
    FAINT,
    between_poses,
    innovation,
    is_degenerate,
    robust_ratio,
    step_covariance,
    wrapped,
)
from mapmyworld.kernels.planar_algebra import invert3
from mapmyworld.kernels.scan_alignment import Rows, align
from mapmyworld.kernels.step_model import learn_step, next_variances
from mapmyworld.kernels.wheel_model import POSE, anchor, learn, reckon, reckoned_variances

_MEMORY = 0.95  # weight of the past in the running mean of disagreements
_LARGEST = 9.0  # that one overlap may teach, times its variance
_WELL_EXPLAINED = 0.75  # overlap below which a scan joins the submap sooner
_SOONER = 0.3  # of the motion after which others do
_FIRST_VARIANCE = 0.01  # of overlaps, before there are any


@jit
def explains(state: Array, overlap: float, settings: Array, has_odometry: bool) -> bool:
    """Whether a submap explains as much of a scan as can be expected, and as much as is needed.

    Expected is what it explained of the scans before: a match that shares a wall or two with the
    right one explains far less than those do. Without odometry no measurement has led there, and
    a closer look has none to go by. `state` (8,) and `settings` (7,) are those of `track_scans`.
    """
    missing = max(state[6] - overlap, 0.0) if has_odometry else 0.0
    return bool(overlap >= settings[4] and missing * missing <= settings[3] * state[7])


@jit
def learn_overlap(state: Array, overlap: float) -> None:
    """Lets mean and variance of overlaps, in `state` (8,), learn from a match that is believed."""
    if state[7] == 0.0:
        state[6], state[7] = overlap, _FIRST_VARIANCE
    miss = overlap - state[6]
    sample = min(miss * miss, _LARGEST * state[7])
    state[6] += (1.0 - _MEMORY) * miss
    state[7] += (1.0 - _MEMORY) * (sample - state[7])


@jit
def is_new(
    pose: Array, overlap: float, distance: float, angle: float, key_poses: Array, keys: Index
) -> bool:
    """Whether a scan at `pose` (3,) says something that the newest keyframe does not.

    `key_poses` (K, 3) and `keys` (2,) are those of `remember_scan`.
    """
    if keys[1] == 0:
        return True
    step = between_poses(key_poses[keys[0]], pose)
    near = 1.0 if overlap > _WELL_EXPLAINED else _SOONER
    return bool(np.hypot(step[0], step[1]) >= near * distance or abs(step[2]) >= near * angle)


@jit
def remember_scan(
    rows: Rows, origin: Array, pose: Array, overlap: float, distance: float, angle: float,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    keys: Index,
) -> bool:  # fmt: skip
    """Lets a scan join the submap, a ring of keyframes, where it says something new; if it did.

    The scan is `rows` (N, 6), seen from `origin` (2,) on the base at `pose` (3,). The ring has rows
    (K, P, 6), counts (K,), origins (K, 2) and poses (K, 3); `keys` (2,) holds the slot of the
    newest keyframe and how many there are.
    """
    slots = len(key_counts)
    if not is_new(pose, overlap, distance, angle, key_poses, keys):
        return False
    slot = (keys[0] + 1) % slots
    # Number by number: numba's assignment of slices takes seconds to compile.
    for i in range(len(rows)):
        for j in range(6):
            key_rows[slot, i, j] = rows[i, j]
    key_counts[slot] = len(rows)
    key_origins[slot, 0], key_origins[slot, 1] = origin[0], origin[1]
    for i in range(3):
        key_poses[slot, i] = pose[i]
    keys[0], keys[1] = slot, min(keys[1] + 1, slots)
    return True


@jit
def chosen_keyframes(back: Index, keys: Index, slots: int) -> Index:
    """(K,) slots of the keyframes that lie `back` (B,) places back in the ring, if there.

    `keys` (2,) are those of `remember_scan`.
    """
    found = np.empty(len(back), np.int64)
    count = 0
    for b in back:
        if b <= keys[1]:
            found[count] = (keys[0] - b + 1) % slots
            count += 1
    return found[:count]


@inner_jit
def match_keyframes(
    rows: Rows, first: int, last: int,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    which: Index, predicted: Array, known: Array, max_distances: Array, settings: Array,
    out: Array, information: Array,
) -> None:  # fmt: skip
    """Aligns a scan with keyframes; fills `out` (11,) as `align` does, and the match's information.

    The scan is `rows[first:last]`, `rows` (N, 6). The ring has `key_rows` (K, P, 6), `key_counts`
    (K,), `key_origins` (K, 2), `key_poses` (K, 3), as of `remember_scan`; `which` (B,) are slots.
    The `predicted` pose (3,) has information `known`, the match `information`, (3, 3) both.
    `max_distances` (R,) as of `align`, `settings` (7,) of `track_scans`.
    """
    capacity = key_rows.shape[1]
    starts, ends = np.empty(len(key_counts), np.int64), np.empty(len(key_counts), np.int64)
    for k in range(len(key_counts)):
        starts[k], ends[k] = k * capacity, k * capacity + key_counts[k]
    align(
        rows, first, last, key_rows.reshape(-1, 6), starts, ends, which, key_poses,
        key_origins, predicted, known, max_distances, settings[0],
        settings[1] * np.sqrt(settings[2]), out,
    )  # fmt: skip
    variance = max(settings[1] * settings[1], out[10]) * settings[2]
    slot = 3
    for i in range(3):
        for j in range(i, 3):
            value = out[slot] / (variance * max(len(which), 1))
            information[i, j] = information[j, i] = value
            slot += 1


@jit
def learn_matching(
    rows: Rows, first: int, last: int,
    key_rows: NDArray[np.float32], key_counts: Index, key_origins: Array, key_poses: Array,
    which: Index, pose: Array, max_distances: Array, settings: Array,
) -> None:  # fmt: skip
    """Lets the variance factor of matches learn from how two keyframes differ about a scan.

    Aligned with each alone, the scan comes out at two poses; these differ by what their covariances
    indicate, times the factor. Along walls that leave it open it stays where it began, and has two
    unknowns. The scan is `rows[first:last]` (N, 6) at `pose` (3,); the ring has
    `key_rows` (K, P, 6), `key_counts` (K,), `key_origins` (K, 2), `key_poses` (K, 3), as of
    `remember_scan`; `which` (B,) are slots. `max_distances` (R,) as of `align`, `settings` (7,) of
    `track_scans`.
    """
    if len(which) < 2:
        return
    found, none = np.zeros(11), np.zeros((3, 3))
    poses, total = np.zeros((2, 3)), np.zeros((3, 3))
    information = np.zeros((3, 3))
    for k in range(2):
        match_keyframes(
            rows, first, last, key_rows, key_counts, key_origins, key_poses, which[k : k + 1],
            pose, none, max_distances, settings, found, information,
        )  # fmt: skip
        for i in range(3):
            poses[k, i] = found[i]
            information[i, i] += FAINT
        own = invert3(information)
        for i in range(3):
            for j in range(3):
                total[i, j] += own[i, j]
    apart, weights, squared = between_poses(poses[0], poses[1]), invert3(total), 0.0
    for i in range(3):
        for j in range(3):
            squared += apart[i] * weights[i, j] * apart[j]
    unknowns = 2 if is_degenerate(weights) else 3
    settings[2] *= 1.0 + (1.0 - _MEMORY) * (robust_ratio(squared, unknowns) - 1.0)


@jit
def track_scans(
    start: int,
    rows: Rows,
    bounds: Index,
    origins: Array,
    recorded: Array,
    interpolated: NDArray[np.bool_],
    key_rows: NDArray[np.float32],
    key_counts: Index,
    key_origins: Array,
    key_poses: Array,
    keys: Index,
    back: Index,
    state: Array,
    wheels: Array,
    steps: Array,
    max_distances: Array,
    settings: Array,
    fewest: int,
    out: Array,
    covariances: Array,
) -> int:
    """Follows scans from `start` on; the index of the first that needs a closer look.

    Scan k is `rows[bounds[k]:bounds[k + 1]]`, `rows` (N, 6) and `bounds` (B + 1,), seen from
    `origins` (B, 2) on the base. `recorded` (B, 3) are odometry's steps, NaN where there is none;
    those that end at an `interpolated` (B,) pose need a closer look. The ring, `key_rows`
    (K, P, 6), `key_counts` (K,), `key_origins` (K, 2), `key_poses` (K, 3) and `keys` (2,), is that
    of `remember_scan`; a scan is aligned with keyframes `back` (M,) places, by `max_distances` (R,)
    as of `align`. `state` (8,) is the pose, the last step, mean and variance of overlaps, `wheels`
    (56,) the model of the odometry, `steps` (6,) that of a robot without; `settings` (7,) are
    residual share, sigma of a range, correlation, limits of NIS and overlap, keyframe distance and
    angle. Fills `out` (B, 7): pose, overlap, NIS, metres moved, weak (1 or 0); and `covariances`
    (B, 3, 3) of the steps.
    """  # fmt: skip
    found, predicted, pose = np.zeros(11), np.empty(3), np.empty(3)
    information, known = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(start, len(bounds) - 1):
        if bounds[k + 1] - bounds[k] < fewest or keys[1] == 0 or interpolated[k]:
            return k
        has_odometry = not np.isnan(recorded[k, 0])
        if has_odometry:
            before = wheels.copy()
            reckon(wheels, recorded[k])
            reckoned = wheels[POSE]
            for i in range(3):
                predicted[i] = reckoned[i]
            variances = reckoned_variances(wheels)
            grown = variances - reckoned_variances(before)
        else:
            before = wheels
            c, s = np.cos(state[2]), np.sin(state[2])
            predicted[0] = state[0] + c * state[3] - s * state[4]
            predicted[1] = state[1] + s * state[3] + c * state[4]
            predicted[2] = wrapped(state[2] + state[5])
            variances = grown = next_variances(steps)
        for i in range(3):
            known[i, i] = 1.0 / variances[i]
        which = chosen_keyframes(back, keys, len(key_counts))
        match_keyframes(
            rows, bounds[k], bounds[k + 1], key_rows, key_counts, key_origins, key_poses, which,
            predicted, known, max_distances, settings, found, information,
        )  # fmt: skip
        for i in range(3):
            pose[i] = found[i]
        innovations = innovation(predicted, pose, information, variances)
        if innovations[6] > settings[3] or not explains(state, found[9], settings, has_odometry):
            for i in range(len(wheels)):
                wheels[i] = before[i]
            return k
        moved = between_poses(state, pose)
        out[k, 6] = 1.0 if is_degenerate(information) else 0.0
        if not has_odometry:
            learn_step(steps, moved, state[3:6], information, variances, out[k, 6] > 0.0)
        total = step_covariance(moved, information, variances, grown, settings[5], settings[6])
        for i in range(3):
            for j in range(3):
                covariances[k, i, j] = total[i, j]
            out[k, i], state[i], state[3 + i] = pose[i], pose[i], moved[i]
        out[k, 3], out[k, 4], out[k, 5] = found[9], innovations[6], np.hypot(moved[0], moved[1])
        learn_overlap(state, found[9])
        if is_new(pose, found[9], settings[5], settings[6], key_poses, keys):
            learn_matching(
                rows, bounds[k], bounds[k + 1], key_rows, key_counts, key_origins, key_poses,
                which, pose, max_distances, settings,
            )  # fmt: skip
        if remember_scan(
            rows[bounds[k] : bounds[k + 1]], origins[k], pose, found[9], settings[5], settings[6],
            key_rows, key_counts, key_origins, key_poses, keys,
        ):  # fmt: skip
            if has_odometry:
                learn(wheels, innovations, out[k, 6] > 0.0)
            anchor(wheels, pose)
    return len(bounds) - 1
