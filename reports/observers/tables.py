"""Observers as tables of the terminal."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.observers.reduced_order import steady_state_error
from dqforge.reports.pages.table import Table


def observer_table(design: Design, gains: GainSet) -> Table:
    """The speed observer as a table of the terminal."""
    observer, machine = gains.observer, design.machine
    assert observer is not None
    rows = (
        ("A", f"{observer.a:.7g}", ""),
        ("B_U", f"{observer.b_u:.7g}", "rad/(s V)"),
        ("B_I", f"{observer.b_i:.7g}", "rad/(s A)"),
        ("C", f"{observer.c:.7g}", "rad/(s A)"),
    )
    error = steady_state_error(
        machine, observer.g, observer.t_s, design.control.bases.speed, 1.0, r_error=0.3
    )
    rpm = 30.0 / math.pi
    load, resistance = error.load * rpm, error.resistance / error.i_q * rpm
    notes = (
        "steady speed error: none with exact parameters and no load;",
        f"an unknown load torque shifts the estimate by {load:.3g} rpm per N m,",
        f"a resistance that is 30 % too high by {resistance:.3g} rpm per A of i_q",
    )
    return Table(
        "Speed observer: omega_hat = zeta - C i_q; zeta' = A zeta + B_U u_q + B_I i_q",
        ("", "value", "unit"),
        rows,
        notes,
    )
