"""Names for the arrays that are passed between functions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # which works on the arrays that are named here
    pass


BoolArray = NDArray[np.bool_]


IndexArray = NDArray[np.intp]


FloatArray = NDArray[np.float64]
