"""Points summed by voxel in a hash table of plain, small arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit, jit

BITS = 21  # of a voxel index along each axis: a million voxels either way
OFFSET = 1 << (BITS - 1)
FULL = 255  # points of a voxel that count
STEPS = 256  # in which a point's place within its voxel is reported
TURNS = 127  # in which a normal's component is reported
_MIX = np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing: the golden ratio of 64 bits


@inner_jit
def row_of_key(
    key: int, table: NDArray[np.int32], keys: NDArray[np.int64], count: int
) -> tuple[int, int]:
    """The row of a key among `keys` (N,), appended where it is new; how many there are then.

    `table` (T,) holds rows + 1, 0 = free, its length a power of two above the number of keys.
    """
    mask = np.uint64(len(table) - 1)
    mixed = np.uint64(key) * _MIX
    slot = (mixed ^ (mixed >> np.uint64(32))) & mask
    while True:
        row = table[slot] - 1
        if row < 0:
            keys[count] = key
            table[slot] = count + 1
            return count, count + 1
        if keys[row] == key:
            return row, count
        slot = (slot + np.uint64(1)) & mask


@jit
def fill_table(table: NDArray[np.int32], keys: NDArray[np.int64], count: int) -> None:
    """Spreads the first `count` of `keys` (N,), all different, over an empty `table` (T,)."""
    for row in range(count):
        row_of_key(keys[row], table, keys, row)


@jit
def add_points(
    points: NDArray[np.float64],
    colours: NDArray[np.uint8],
    normals: NDArray[np.float32],
    size: float,
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    sums: NDArray[np.uint16],
    count: int,
) -> int:
    """Adds points (N, 3) to their voxels' sums (K, 10); how many voxels there are then.

    With their `colours` and `normals` (N, 3); `table` (T,) and `keys` (K,) as of `row_of_key`. A
    sum holds the points' number, offsets from the voxel's corner in steps of 1 / STEPS, colours,
    and normals in steps of 1 / TURNS, raised by one to be positive. The first FULL points of a
    voxel decide: so many bytes fit in 16 bits.
    """
    cell = np.zeros(3, np.int64)
    for i in range(len(points)):
        inside = True
        for c in range(3):
            index = np.floor(points[i, c] / size)
            if not abs(index) < OFFSET:
                inside = False
                break
            cell[c] = int(index)
        if not inside:
            continue
        key = (cell[0] + OFFSET) << (2 * BITS) | (cell[1] + OFFSET) << BITS | (cell[2] + OFFSET)
        row, count = row_of_key(key, table, keys, count)
        if sums[row, 0] == FULL:
            continue
        sums[row, 0] += np.uint16(1)
        for c in range(3):
            share = points[i, c] / size - cell[c]
            sums[row, 1 + c] += np.uint16(min(max(int(share * STEPS), 0), STEPS - 1))
            sums[row, 4 + c] += np.uint16(colours[i, c])
            sums[row, 7 + c] += np.uint16(int(np.rint((normals[i, c] + 1.0) * TURNS)))
    return count
