"""Plain data: what JSON and templates are given."""

from __future__ import annotations

from typing import Any

import numpy as np

PlainData = dict[str, Any]


def shortest(value: np.float32) -> float:
    """The double whose shortest decimal is that of the float: 0.1 for float32(0.1)."""
    return float(str(value))
