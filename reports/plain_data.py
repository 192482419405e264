"""Plain data: what JSON and templates are given."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

PlainData = dict[str, Any]


def finite(value: float) -> float | None:
    """The number, or null for what JSON cannot hold."""
    return value if math.isfinite(value) else None


def shortest(value: np.float32) -> float:
    """The double whose shortest decimal is that of the float: 0.1 for float32(0.1)."""
    return float(str(value))
