"""Everything that is recomputed of paper 002: printed beside found."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.papers.paper002.figure_list import PRINTED_CONDITIONS
from dqforge.reports.papers.paper002_definitions.back_emf_components import ComponentRow, table_3_1
from dqforge.reports.papers.paper002_definitions.bench_currents import (
    BENCH_TORQUE,
    DESIGN_NAME,
    BenchCurves,
    CurveFigure,
    bench_curves,
    bench_machine,
    curve_figures,
    telling_orders,
)
from dqforge.reports.papers.paper002_definitions.compensation import (
    TRAPEZOID_FLUX,
    Compensation,
    compensation,
    shipped_machine,
    trapezoid_machine,
)
from dqforge.reports.papers.paper002_definitions.misprints import ModelCheck, check_model
from dqforge.reports.papers.paper002_loops.closed_loops import BENCH_SPEED, ClosedLoops, run_loops
from dqforge.reports.papers.paper002_loops.diode_path import DiodePath, diode_path
from dqforge.reports.papers.paper002_loops.loss_ratios import LoopRatio, loop_ratios

TERMS_TORQUE = 3.5  # N m, at which the terms of Figure 4.3 are shown; chosen near the rated torque.
TERMS_SPEED = 1800.0  # rpm, the rated speed.


@dataclass(frozen=True, slots=True)
class Condition:
    """A number that chapter 6 states, and what the shipped design has; in ``unit``."""

    name: str
    printed: float
    unit: str
    place: str
    used: float


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """Table 3.1, the conditions of chapter 6, chapter 4 judged, its terms over the angle, and the
    curves of chapter 6 from the definitions with the numbers read off them.

    ``telling`` are the orders by which the currents of dqx and dqy differ, the largest first.
    ``loops`` and ``ratios`` are those of the emitted C, None and empty where ``loops_left_out``
    says why.
    """

    rows: tuple[ComponentRow, ...]
    conditions: tuple[Condition, ...]
    model: ModelCheck
    terms: tuple[Compensation, ...]
    curves: BenchCurves
    curve_figures: tuple[CurveFigure, ...]
    telling: tuple[int, ...]
    path: DiodePath
    loops: ClosedLoops | None
    ratios: tuple[LoopRatio, ...]
    loops_left_out: str


def _used(design: Design) -> dict[str, float]:
    machine, waveform, rpm = design.machine, design.waveform, np.pi / 30.0
    speed = machine.omega_m_max
    assert speed is not None
    assert waveform.torque is not None
    assert waveform.omega_m is not None
    return {
        "poles": 2.0 * machine.pole_pairs,
        "rated power": machine.torque_per_ampere * design.i_max * speed,
        "dc link": design.inverter.v_dc,
        "rated current": design.i_max / 2.0**0.5,
        "rated speed": speed / rpm,
        "speed": waveform.omega_m / rpm,
        "torque": waveform.torque,
        "sampling period": 1e6 * design.control.t_s,
        "switching frequency": 1e-3 * design.inverter.f_sw,
    }


def conditions() -> tuple[Condition, ...]:
    """The stated numbers beside those of the shipped design."""
    used = _used(catalogue.load(DESIGN_NAME))
    return tuple(
        Condition(name, value, unit, place, used[name])
        for name, (value, unit, place) in PRINTED_CONDITIONS.items()
    )


def _closed_loops() -> tuple[ClosedLoops | None, tuple[LoopRatio, ...], str]:
    """What runs in the loop, or why nothing does."""
    try:
        require_compiler()
    except VerificationError as error:
        return None, (), str(error)
    return run_loops(), loop_ratios(), ""


def reproduce_paper() -> Reproduction:
    """Recompute everything; without a C compiler all but the closed loops."""
    machine, omega_e = bench_machine(), TERMS_SPEED * np.pi / 30.0
    omega_e *= machine.pole_pairs
    shipped = shipped_machine(machine)
    curves = bench_curves()
    loops, ratios, left_out = _closed_loops()
    point = (machine.pole_pairs, TERMS_TORQUE, omega_e)
    return Reproduction(
        rows=table_3_1(),
        conditions=conditions(),
        model=check_model(shipped, *point),
        terms=(
            compensation("shipped drive (inferred)", shipped, *point),
            compensation(
                f"trapezoid, {TRAPEZOID_FLUX:g} Wb (chosen)", trapezoid_machine(machine), *point
            ),
        ),
        curves=curves,
        curve_figures=curve_figures(curves),
        telling=telling_orders(curves),
        path=diode_path(machine, BENCH_TORQUE, BENCH_SPEED),
        loops=loops,
        ratios=ratios,
        loops_left_out=left_out,
    )
