"""Pictures as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mapmyworld.errors import MapError


def write_picture(path: Path, rgb: NDArray[np.uint8]) -> None:
    """An RGB picture (H, W, 3) as PNG, or what else the name's ending says."""
    try:
        written = cv2.imwrite(str(path), np.ascontiguousarray(rgb[:, :, ::-1]))
    except cv2.error:
        raise MapError(f"{path}: give the picture a name that ends in .png or .jpg") from None
    if not written:
        raise MapError(f"{path}: the picture cannot be written: does its folder exist?")
