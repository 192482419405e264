"""Table 3.1 of paper 002 beside the printed values, copper losses, and Figures 2.3 to 3.2.

The printed values are facts of the thesis; where they contain misprints the
notes say how they are read.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frames import (
    Frame,
    frame_rms,
    loss_ratio_x_over_y,
    thesis_shapes,
    transform,
)
from dqforge.machines.records import dataclass

ANGLES = 7200

# R.m.s. of the components of the back-EMF of unit amplitude.
PRINTED_TABLE_3_1 = {
    "balanced sine": {"d": 0.0, "q": 1.22, "qx": 1.22, "qy": 1.22, "zero": 0.0},
    "one phase at half amplitude": {"d": 0.14, "q": 1.02, "qx": 1.03, "qy": 1.06, "zero": 0.20},
    "one phase missing": {"d": 0.28, "q": 0.86, "qx": 0.91, "qy": 0.99, "zero": 0.40},
    "trapezoid": {"d": 0.15, "q": 1.49, "qx": 1.83, "qy": 1.92, "zero": 0.30},
}

COMPONENTS = ("d", "q", "qx", "qy", "zero")  # Columns of the table, as `dq_frames` names them.

# The frame of each figure of the back-EMF; the phases themselves in the first.
FRAMES: dict[str, Frame | None] = {
    "2.3": None,
    "2.4": "alphabeta0",
    "2.5": "dq0",
    "2.6": "dqx",
    "3.2": "dqy",
}

_FRAME_POINTS = 720


@dataclass(frozen=True, slots=True)
class ComponentRow:
    """One row of Table 3.1: printed and recomputed r.m.s. by component, and the
    copper loss of dqx over dqy.
    """

    shape: str
    printed: dict[str, float]
    found: dict[str, float]
    loss_ratio: float


def table_3_1() -> tuple[ComponentRow, ...]:
    """R.m.s. of every component for the four shapes of the thesis."""
    rows = []
    for name, shape in thesis_shapes(ANGLES).items():
        found = frame_rms(shape)
        values = {component: float(getattr(found, component)) for component in COMPONENTS}
        rows.append(ComponentRow(name, PRINTED_TABLE_3_1[name], values, loss_ratio_x_over_y(shape)))
    return tuple(rows)


def frame_curves() -> dict[str, dict[str, FloatArray]]:
    """Back-EMF of unit amplitude by figure and shape, shape (3, N) over a period:
    Figures 2.3 to 2.6 and 3.2.
    """
    shapes = thesis_shapes(_FRAME_POINTS)
    theta = 2.0 * np.pi * np.arange(_FRAME_POINTS) / _FRAME_POINTS

    def components(frame: Frame | None, shape: FloatArray) -> FloatArray:
        return (
            shape
            if frame is None
            else np.einsum("jkm,mj->kj", transform(frame, theta, shape), shape)
        )

    return {
        number: {name: components(frame, shape) for name, shape in shapes.items()}
        for number, frame in FRAMES.items()
    }
