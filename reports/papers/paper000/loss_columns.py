"""Table 4 of paper 000 recomputed: losses, junction temperature and torque
ripple of its three strategies.

One figure is fitted, the total loss of the first column; it gives the switching energy. The other
totals follow. The printed third total contradicts its own temperature; the result stands beside
both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.modulation.ripple import ripple
from dqforge.machines.names import ModulationName, Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import DriveBudget, drive_budget
from dqforge.optimizer.losses.switching_calibration import calibrate_switching
from dqforge.optimizer.operating_points.mtpa import id0_currents, mtpa_currents

Column = tuple[Strategy, ModulationName, float, float, float]

# Strategy, modulator, total loss in W, junction temperature in degC, largest torque ripple in N m.
PRINTED_TABLE_4: tuple[Column, ...] = (
    ("id0", "spwm", 1064.0, 112.32, 3.17),
    ("mtpa", "spwm", 934.0, 106.54, 3.21),
    ("mtpa", "ddt-gdpwm", 759.0, 98.73, 3.59),
)

# Operating point of the table in N m and rad/s; 500 V and 100 kHz are those of the library drive.
POINT_TORQUE = 130.0
POINT_SPEED = 300.0


@dataclass(frozen=True, slots=True)
class LossRow:
    """One column of Table 4, printed and recomputed.

    Args:
        strategy, modulation: What the column compares.
        printed_loss, loss: Total loss in W.
        implied_loss: Total in W that the printed temperature implies, on the straight line of
            temperature over inverter loss through the first two columns as they are printed.
        copper, conduction, switching: Parts of the recomputed total in W.
        printed_junction, junction: Junction temperature in degC.
        printed_ripple, switching_ripple: Largest peak-to-peak torque in N m: printed, which has the
            slots of a finite-element machine in it, and what the switched voltages make in the
            linear machine.
    """

    strategy: Strategy
    modulation: ModulationName
    printed_loss: float
    loss: float
    implied_loss: float
    copper: float
    conduction: float
    switching: float
    printed_junction: float
    junction: float
    printed_ripple: float
    switching_ripple: float


def _currents(design: Design, strategy: Strategy) -> tuple[float, float]:
    torque = np.array([POINT_TORQUE])
    i_d, i_q = (id0_currents if strategy == "id0" else mtpa_currents)(
        linearised(design.machine), torque
    )
    return float(i_d[0]), float(i_q[0])


def _budget(design: Design, inverter: Inverter, column: Column) -> DriveBudget:
    i_d, i_q = _currents(design, column[0])
    return drive_budget(design.machine, inverter, [i_d], [i_q], [POINT_SPEED], (column[1],))


def calibrated_inverter(design: Design) -> Inverter:
    """Inverter whose switching energy makes the total of the first column,
    all other losses being counted.
    """
    first = PRINTED_TABLE_4[0]
    found = _budget(design, design.inverter, first)
    rest = found.total - found.copper - found.conduction - found.switching
    device = calibrate_switching(
        first[2] - float(rest[0, 0, 0]),
        design.machine,
        design.inverter,
        *_currents(design, first[0]),
        POINT_SPEED,
        first[1],
    )
    return replace(design.inverter, device=device)


def implied_totals(copper: tuple[float, ...]) -> tuple[float, ...]:
    """Totals in W that the printed temperatures imply, from the copper losses in W of the columns.

    Temperature is straight over the inverter's loss, total less copper;
    the line goes through the first two columns.
    """
    inverter = [column[2] - copper[k] for k, column in enumerate(PRINTED_TABLE_4)]
    (hot, warm), (most, less) = (column[3] for column in PRINTED_TABLE_4[:2]), inverter[:2]
    per_kelvin = (most - less) / (hot - warm)
    return tuple(
        copper[k] + less + per_kelvin * (column[3] - warm)
        for k, column in enumerate(PRINTED_TABLE_4)
    )


def table_4(design: Design) -> tuple[LossRow, ...]:
    """Losses, junction temperature and torque ripple, the switching energy calibrated
    on the first total alone.
    """
    inverter = calibrated_inverter(design)
    budgets = [_budget(design, inverter, column) for column in PRINTED_TABLE_4]
    implied = implied_totals(tuple(float(found.copper[0, 0, 0]) for found in budgets))
    rows = []
    for column, found, total in zip(PRINTED_TABLE_4, budgets, implied, strict=True):
        strategy, modulation, printed_loss, printed_junction, printed_ripple = column
        i_d, i_q = _currents(design, strategy)
        made = ripple(
            modulation,
            design.machine,
            i_d,
            i_q,
            POINT_SPEED,
            v_dc=inverter.v_dc,
            f_sw=inverter.f_sw,
        )
        rows.append(
            LossRow(
                strategy=strategy,
                modulation=modulation,
                printed_loss=printed_loss,
                loss=float(found.total[0, 0, 0]),
                implied_loss=total,
                copper=float(found.copper[0, 0, 0]),
                conduction=float(found.conduction[0, 0, 0]),
                switching=float(found.switching[0, 0, 0]),
                printed_junction=printed_junction,
                junction=float(found.junction_temperature[0, 0, 0]),
                printed_ripple=printed_ripple,
                switching_ripple=float(made.torque),
            )
        )
    return tuple(rows)
