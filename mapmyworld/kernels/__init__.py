"""Numba kernels on plain arrays; compiled once, cached, releasing the interpreter lock."""
