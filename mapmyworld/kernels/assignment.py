"""One array's values into another of the same shape.

Inside a kernel `target[:] = source` compiles the text of an error of shapes as well, which takes
five seconds of a first start.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from mapmyworld.kernels.compiling import inner_jit


@inner_jit
def assign(target: NDArray[Any], source: NDArray[Any]) -> None:
    """Copies all of `source` (...) into the first elements of `target` (...), in row order."""
    for i in range(source.size):
        target.flat[i] = source.flat[i]
