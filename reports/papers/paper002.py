"""Paper 002 recomputed: Table 3.1 beside the printed values, copper losses,
and the figures of frames and currents.

The printed values are facts of the thesis; where they contain misprints the
notes say how they are read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.phase_machines.frames import (
    FrameAngles,
    frame_angles,
    frame_rms,
    loss_ratio_x_over_y,
    thesis_shapes,
)
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.optimizer.waveforms.comparison import require_phases
from dqforge.optimizer.waveforms.phase_currents import spectrum, unit_currents
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

DESIGN_NAME = "paper002-phase-waveforms"


ANGLES = 7200


PRINTED_TABLE_3_1 = {
    "balanced sine": {"d": 0.0, "q": 1.22, "qx": 1.22, "qy": 1.22, "zero": 0.0},
    "one phase at half amplitude": {"d": 0.14, "q": 1.02, "qx": 1.03, "qy": 1.06, "zero": 0.20},
    "one phase missing": {"d": 0.28, "q": 0.86, "qx": 0.91, "qy": 0.99, "zero": 0.40},
    "trapezoid": {"d": 0.15, "q": 1.49, "qx": 1.83, "qy": 1.92, "zero": 0.30},
}

"""R.m.s. of the components of the back-EMF of unit amplitude."""


_COMPONENTS = ("d", "q", "qx", "qy", "zero")


_TORQUE = 1.0


_ORDERS = (1, 3, 5, 7, 9)


@dataclass(frozen=True, slots=True)
class ComponentRow:
    """One row of Table 3.1: printed and recomputed r.m.s. by component, and the
    copper loss of dqx over dqy.
    """

    shape: str
    printed: dict[str, float]
    found: dict[str, float]
    loss_ratio: float


@dataclass(frozen=True, slots=True)
class DriveCurves:
    """Figures 6.4 to 6.9 for the shipped drive: frame angles, and the current of phase
    a at 1 N m by dqx and dqy.

    ``currents`` in A, shape (2, N), first dqx; ``harmonics`` in A (peak), shape (2, H), of orders
    0..H-1; ``i_qy`` in A is the constant q current of dqy (power-invariant, as in the thesis).
    """

    angles: FrameAngles
    currents: FloatArray
    harmonics: FloatArray
    i_qy: float


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The table and the drive's curves."""

    rows: tuple[ComponentRow, ...]
    drive: DriveCurves


def table_3_1() -> tuple[ComponentRow, ...]:
    """R.m.s. of every component for the four shapes of the thesis."""
    rows = []
    for name, shape in thesis_shapes(ANGLES).items():
        found = frame_rms(shape)
        values = {component: float(getattr(found, component)) for component in _COMPONENTS}
        rows.append(ComponentRow(name, PRINTED_TABLE_3_1[name], values, loss_ratio_x_over_y(shape)))
    return tuple(rows)


def drive_curves() -> DriveCurves:
    """Curves of the shipped drive at 1 N m."""
    drive = require_phases(catalogue.load(DESIGN_NAME))
    machine = drive.phases if isinstance(drive, SalientPhaseMachine) else drive
    phi_m = float(np.max(np.abs(machine.flux)))
    currents = np.stack([_TORQUE * unit_currents(machine, rule)[0] for rule in ("dqx", "dqy")])
    i_qy = _TORQUE / (machine.pole_pairs * phi_m * np.sqrt(1.5))
    return DriveCurves(
        frame_angles(machine.flux / phi_m), currents, spectrum(currents)[0], float(i_qy)
    )


def reproduce_paper() -> Reproduction:
    """Recompute everything."""
    return Reproduction(table_3_1(), drive_curves())


def reproduction_tables(reproduction: Reproduction) -> list[Table]:
    """Printed and recomputed values side by side."""
    components = tuple(
        (
            row.shape,
            *(f"{row.printed[name]:.2f} / {row.found[name]:.3f}" for name in _COMPONENTS),
            f"{row.loss_ratio:.3f}",
        )
        for row in reproduction.rows
    )
    names = ("", *(f"{name} printed / found" for name in _COMPONENTS), "copper loss dqx over dqy")
    drive = reproduction.drive
    harmonics = tuple(
        (f"{order}", *(f"{1e3 * drive.harmonics[k, order]:.2f}" for k in range(2)))
        for order in _ORDERS
    )
    return [
        Table(
            "Paper 002, Table 3.1: r.m.s. of the components of the back-EMF of unit amplitude",
            names,
            components,
            (
                "The trapezoid's 1.83 and 1.92 are r.m.s.(|F|^2)/sqrt(3/2), another quantity.",
                "The trapezoid's printed d is not that of a flat top of 120 degrees.",
                (
                    "Copper losses at the same constant torque; power-invariant components, as in "
                    "the thesis."
                ),
            ),
        ),
        Table(
            "Paper 002, Figure 6.7 for the shipped drive at 1 N m: harmonics of the current of "
            "phase a",
            ("order", "dqx mA (peak)", "dqy mA (peak)"),
            harmonics,
            (
                (
                    f"i_qy is constant, {drive.i_qy:.4g} A = T / (p phi_m sqrt(3/2)), "
                    "power-invariant; (4.4) errs."
                ),
                (
                    "The drive's harmonics are assumed: the thesis shows its back-EMF as a figure "
                    "only."
                ),
            ),
        ),
    ]


def plain_reproduction(reproduction: Reproduction) -> PlainData:
    """Table and curves as plain data."""
    drive = reproduction.drive
    return {
        "table_3_1": [
            {
                "shape": row.shape,
                "printed": row.printed,
                "found": row.found,
                "loss_ratio_dqx_over_dqy": row.loss_ratio,
            }
            for row in reproduction.rows
        ],
        "drive": {
            "theta_x_rad": drive.angles.theta_x,
            "theta_y_rad": drive.angles.theta_y,
            "a_x": drive.angles.a_x,
            "a_y": drive.angles.a_y,
            "current_a_dqx_A": drive.currents[0],
            "current_a_dqy_A": drive.currents[1],
            "i_qy_A": drive.i_qy,
        },
    }
