"""Numba kernels of the particle filter; each treats particles or poses one by one."""
