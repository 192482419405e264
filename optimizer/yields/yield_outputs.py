"""Outputs of a study with a fixed header, for many machines at once, by their names.

Losses are those of `header_budget`, by the names that a study has for a budget anyway.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.optimizer.yields.fixed_header import FixedHeader
from dqforge.optimizer.yields.loop_yield import (
    LOOPS,
    MARGINS,
    axis_inductance,
    fixed_loop,
    least_phase_margin,
    loop_outputs,
)
from dqforge.optimizer.yields.reference_yield import (
    Machines,
    loss_penalties,
    produced_torque,
    reference_points,
    torque_errors,
)

# Largest torque error over the full scale of the header, a share.
TORQUE_ERROR = "reference.torque_error"

# Largest excess of the copper loss over the least one of the machine, a share of that.
LOSS_PENALTY = "reference.loss_penalty"

# Torque in N m that the machine makes where the full scale of the header is asked for.
TORQUE_MADE = "reference.torque_made"

# Torque in N m at which the header clamps what is asked for, the same on every machine.
TORQUE_MAX = "reference.torque_max"
LEAST_MARGIN = "gains.phase_margin"  # Least phase margin in rad over the current loops.


def output_names(header: FixedHeader) -> tuple[str, ...]:
    """Outputs of reference and gains that a header has.

    Args:
        header: The header.
    """
    loops = [loop for loop in LOOPS if getattr(header, loop) is not None]
    penalty = () if header.speed is not None else (LOSS_PENALTY,)
    gains = [f"gains.{loop}.{margin}" for loop in loops for margin in MARGINS]
    return (
        TORQUE_MAX,
        TORQUE_ERROR,
        TORQUE_MADE,
        *penalty,
        *gains,
        *((LEAST_MARGIN,) if loops else ()),
    )


def yield_outputs(
    header: FixedHeader,
    machines: Machines,
    wanted: Collection[str],
    v_dc: FloatArray | float | None = None,
) -> dict[str, FloatArray]:
    """Outputs of N machines under one header, by name in the order of ``wanted``, arrays of shape
    (N,); NaN for what does not exist.

    Args:
        header: What is flashed to every drive.
        machines: N machines.
        wanted: Names of outputs, as `output_names` has them; what none of them needs is not
            computed.
        v_dc: DC-link voltage in V of each drive, one number or shape (N,); that of the header when
            None.

    Raises:
        InputError: A name is none of those that a fixed header has.
    """
    check_outputs(header, wanted)
    voltage = header.v_dc if v_dc is None else v_dc
    found = _reference(header, machines, wanted) | _gains(header, machines, wanted, voltage)
    return {name: found[name] for name in wanted}


def check_outputs(header: FixedHeader, wanted: Collection[str]) -> None:
    """Refuse outputs of reference and gains that a fixed header does not have.

    Args:
        header: The header.
        wanted: Names of outputs.

    Raises:
        InputError: Names the first of them, and what to write instead.
    """
    known = output_names(header)
    for name in wanted:
        if name in known:
            continue
        if name.startswith("gains."):
            fixed_loop(header, name.split(".")[1])
        if name == LOSS_PENALTY:
            raise InputError(
                f"{name}: the header keeps the voltage limit at {header.speed:.4g} rad/s, its "
                "currents are not meant to be the least; leave the output out"
            )
        raise InputError(
            f"{name}: is not known of a fixed header; write {TORQUE_ERROR}, or leave header out"
        )


def _reference(
    header: FixedHeader, machines: Machines, wanted: Collection[str]
) -> dict[str, FloatArray]:
    found = {TORQUE_MAX: np.full(machines.count, header.torque_max)}
    if not {TORQUE_ERROR, TORQUE_MADE, LOSS_PENALTY}.intersection(wanted):
        return found
    points = reference_points(header)
    produced = produced_torque(points, machines)
    if TORQUE_ERROR in wanted:
        found[TORQUE_ERROR] = torque_errors(header, points, produced)
    if TORQUE_MADE in wanted:
        found[TORQUE_MADE] = produced[-1]
    if LOSS_PENALTY in wanted:
        found[LOSS_PENALTY] = loss_penalties(points, machines, produced)
    return found


def _gains(
    header: FixedHeader,
    machines: Machines,
    wanted: Collection[str],
    v_dc: FloatArray | float,
) -> dict[str, FloatArray]:
    asked = {name.split(".")[1] for name in wanted if name.startswith("gains.")}
    least = LEAST_MARGIN in wanted
    wanted_loops = [loop for loop in LOOPS if loop in asked or least]
    if not wanted_loops:
        return {}
    points, ratio = reference_points(header), v_dc / header.v_dc
    single = {
        loop: loop_outputs(
            fixed_loop(header, loop), machines.r_s, axis_inductance(loop, machines, points), ratio
        )
        for loop in wanted_loops
    }
    found = {
        f"gains.{loop}.{name}": values
        for loop, margins in single.items()
        for name, values in margins.items()
    }
    return found | ({LEAST_MARGIN: least_phase_margin(single)} if least else {})
