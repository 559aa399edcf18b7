"""Colour of every pixel from the triangle it sees: texture, mip level and a fixed light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmyworld.kernels.compiling import jit


@jit
def shade_pixels(
    triangles: NDArray[np.int32],
    barycentric: NDArray[np.float32],
    depths: NDArray[np.float32],
    slants: NDArray[np.float32],
    triangle_uv: NDArray[np.float32],
    triangle_texture: NDArray[np.int32],
    triangle_light: NDArray[np.float32],
    texel_metres: NDArray[np.float32],
    offsets: NDArray[np.int64],
    finest: int,
    texels: NDArray[np.uint8],
    pixel_angle: float,
    sky: NDArray[np.uint8],
    colours: NDArray[np.uint8],
) -> None:
    """Fills `colours` (P, 3); pixels whose depth is infinite show the `sky` (3,).

    A pixel sees one of `triangles` (P,), at `barycentric` (P, 2) and `depths` (P,), m; `slants`
    (P,) are cosines between ray and normal. `triangle_uv` (T, 3, 2) counts repeats of the texture;
    `triangle_texture`, `triangle_light` and `texel_metres` (T,) are which it is, a factor, and the
    size of a texel in m; `offsets` (X, L) are where in `texels` (N, 3) each level of each texture
    begins; `finest` is the edge of the finest level.
    """
    levels = offsets.shape[1]
    for p in range(len(triangles)):
        if not np.isfinite(depths[p]):
            for c in range(3):
                colours[p, c] = sky[c]
            continue
        triangle = triangles[p]
        texture = triangle_texture[triangle]
        b, c2 = barycentric[p, 0], barycentric[p, 1]
        a = 1.0 - b - c2
        corner = triangle_uv[triangle]
        u = a * corner[0, 0] + b * corner[1, 0] + c2 * corner[2, 0]
        v = a * corner[0, 1] + b * corner[1, 1] + c2 * corner[2, 1]
        footprint = depths[p] * pixel_angle / max(np.sqrt(slants[p]), 0.05)
        level = 0
        while level < levels - 1 and footprint > texel_metres[triangle] * 1.5 * (1 << level):
            level += 1
        edge = finest >> level
        x, y = (u - np.floor(u)) * edge - 0.5, (v - np.floor(v)) * edge - 0.5
        x0, y0 = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - x0, y - y0
        x1, y1 = (x0 + 1) % edge, (y0 + 1) % edge
        x0, y0 = x0 % edge, y0 % edge
        base = offsets[texture, level]
        light = triangle_light[triangle]
        for c in range(3):
            top = (
                texels[base + y0 * edge + x0, c] * (1 - fx) + texels[base + y0 * edge + x1, c] * fx
            )
            low = (
                texels[base + y1 * edge + x0, c] * (1 - fx) + texels[base + y1 * edge + x1, c] * fx
            )
            colours[p, c] = np.uint8(min(255.0, light * (top * (1 - fy) + low * fy)))
