"""Pictures as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from formats.whole_files import write_whole
from mapmyworld.errors import MapError


def write_picture(path: Path, rgb: NDArray[np.uint8]) -> None:
    """An RGB picture (H, W, 3) as PNG, or what else the name's ending says.

    Raises `MapError` where that is no picture's.
    """
    try:
        done, data = cv2.imencode(path.suffix, np.ascontiguousarray(rgb[:, :, ::-1]))
    except cv2.error:
        done = False
    if not done:
        raise MapError(f"{path}: give the picture a name that ends in .png or .jpg")
    write_whole(path, data.tobytes())
