"""Whether values keep the bounds that a study sets them."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray

# Share of a bound by which a value may lie beyond it and counts as within: machines differ in the
# last digits, and are to agree.
VERDICT_MARGIN = 1e-9


def within(values: FloatArray, below: float | None, above: float | None) -> BoolArray:
    """Whether values keep their bounds, any shape; what is no number does not.

    Args:
        values: In SI units.
        below, above: Bounds in SI units, None where there is none.
    """
    kept = ~np.isnan(values)
    if below is not None:
        kept &= values <= below + VERDICT_MARGIN * abs(below)
    if above is not None:
        kept &= values >= above - VERDICT_MARGIN * abs(above)
    return np.asarray(kept)
