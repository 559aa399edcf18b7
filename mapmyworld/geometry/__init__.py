"""Rotations and rigid motions as arrays; every function broadcasts over leading axes.

Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
