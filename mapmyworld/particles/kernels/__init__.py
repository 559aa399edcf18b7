"""Numba kernels of the particle filter; each treats particles or poses one by one."""

from mapmyworld.particles.kernels.insertion import insert, touched_tiles
from mapmyworld.particles.kernels.likelihood import surface_distances
from mapmyworld.particles.kernels.matching import match
from mapmyworld.particles.kernels.surface_tiles import TILE, Beams, Surfaces

__all__ = [
    "TILE",
    "Beams",
    "Surfaces",
    "insert",
    "match",
    "surface_distances",
    "touched_tiles",
]
