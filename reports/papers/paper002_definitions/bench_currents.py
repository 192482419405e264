"""Figures 6.2 to 6.16 of paper 002 as they follow from the definitions, for the shipped drive at
the torque of the bench: back-EMF, frames, and the currents of dqx and dqy in every frame.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import to_frame
from dqforge.machines.phase_machines.frames import FrameAngles, frame_angles, loss_ratio_x_over_y
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT
from dqforge.optimizer.waveforms.comparison import require_phases
from dqforge.optimizer.waveforms.phase_currents import spectrum, unit_currents

DESIGN_NAME = "paper002-phase-waveforms"
BENCH_TORQUE = 1.0  # N m, section 6.2.
HIGHEST_ORDER = 13


@dataclass(frozen=True, slots=True, eq=False)
class BenchCurves:
    """Curves of the shipped drive at 1 N m over ``theta`` in rad, shape (N,).

    ``flux`` in Wb, shape (3, N), and ``flux_harmonics`` in Wb (peak), shape (H,), of orders 0..H-1
    of phase a. ``currents`` of phase a in A, shape (2, N), first dqx; ``harmonics`` in A (peak),
    shape (2, H). All others are those of dqy, power-invariant as in the thesis, in A: ``i_qy`` the
    constant reference, ``dqy`` and ``dqx`` divided by a_y and a_x, ``stationary`` alpha, beta and
    0, shape (3, N) each. ``loss_ratio`` is copper loss of dqx over that of dqy.
    """

    theta: FloatArray
    flux: FloatArray
    flux_harmonics: FloatArray
    angles: FrameAngles
    currents: FloatArray
    harmonics: FloatArray
    i_qy: float
    dqy: FloatArray
    dqx: FloatArray
    stationary: FloatArray
    loss_ratio: float


@dataclass(frozen=True, slots=True)
class CurveFigure:
    """A number of a figure: ``expected`` by an identity of the frames, which needs no curve, and
    ``found`` from the currents of the phases.
    """

    figure: str
    quantity: str
    unit: str
    found: float
    expected: float | None = None
    identity: str = ""


def bench_machine() -> PhaseMachine:
    """The shipped machine, without saliency.

    Raises:
        InputError: The shipped design has become one with saliency.
    """
    machine = require_phases(catalogue.load(DESIGN_NAME))
    if isinstance(machine, SalientPhaseMachine):
        raise InputError(f"{DESIGN_NAME} has saliency, which chapter 4 has no equations for")
    return machine


def bench_curves() -> BenchCurves:
    """Curves of the shipped drive at 1 N m."""
    machine = bench_machine()
    phi_m = float(np.max(np.abs(machine.flux)))
    shape = machine.flux / phi_m
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    x, y = (BENCH_TORQUE * unit_currents(machine, rule) for rule in ("dqx", "dqy"))
    currents = np.stack([x[0], y[0]])
    return BenchCurves(
        theta=theta,
        flux=machine.flux,
        flux_harmonics=spectrum(machine.flux)[0][0],
        angles=frame_angles(shape),
        currents=currents,
        harmonics=spectrum(currents)[0],
        i_qy=float(BENCH_TORQUE / (machine.pole_pairs * phi_m * POWER_INVARIANT)),
        dqy=to_frame("dqy", theta, shape, y, scaled=True),
        dqx=to_frame("dqx", theta, shape, y, scaled=True),
        stationary=to_frame("alphabeta0", theta, shape, y),
        loss_ratio=loss_ratio_x_over_y(shape),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _peak(values: FloatArray) -> float:
    return float(np.max(np.abs(values)))


def curve_figures(curves: BenchCurves) -> tuple[CurveFigure, ...]:
    """Numbers of Figures 6.9 to 6.16."""
    i_qy, ratio = curves.i_qy, (curves.angles.a_y / curves.angles.a_x) ** 2
    alpha, beta, zero = curves.stationary
    orders = spectrum(curves.stationary)[0][2]
    reference = "T/(p phi_m sqrt(3/2))"
    x = "i_qy (a_y/a_x)^2"
    whole = float(np.sqrt(np.mean((curves.i_qy * curves.angles.a_y) ** 2)))
    return (
        CurveFigure("6.9", "i_qy, least", "A", float(np.min(curves.dqy[1])), i_qy, reference),
        CurveFigure("6.9", "i_qy, largest", "A", float(np.max(curves.dqy[1])), i_qy, reference),
        CurveFigure("6.9", "i_dy, i_0y, largest", "A", _peak(curves.dqy[::2]), 0.0, "(4.5), (4.6)"),
        CurveFigure(
            "6.10", "i_qx, least", "A", float(np.min(curves.dqx[1])), i_qy * np.min(ratio), x
        ),
        CurveFigure(
            "6.10", "i_qx, largest", "A", float(np.max(curves.dqx[1])), i_qy * np.max(ratio), x
        ),
        CurveFigure("6.11", "i_alpha, r.m.s.", "A", _rms(alpha), _rms(beta), "that of i_beta"),
        CurveFigure("6.11", "i_alpha, peak", "A", _peak(alpha)),
        CurveFigure("6.12", "i_beta, peak", "A", _peak(beta)),
        CurveFigure("6.13", "i_0, r.m.s.", "A", _rms(zero)),
        CurveFigure("6.13", "i_0, peak", "A", _peak(zero)),
        CurveFigure("6.13", "i_0, order 3", "A", float(orders[3])),
        CurveFigure("6.13", "i_0, order 9", "A", float(orders[9])),
        CurveFigure(
            "6.15",
            "length of the current, r.m.s.",
            "A",
            float(np.sqrt(np.mean(np.sum(curves.stationary**2, axis=0)))),
            whole,
            "i_qy a_y",
        ),
        CurveFigure(
            "6.16",
            "i_a, r.m.s.",
            "A",
            _rms(curves.currents[1]),
            whole / 3**0.5,
            "the same / sqrt 3",
        ),
        CurveFigure("6.16", "i_a, peak", "A", _peak(curves.currents[1])),
    )


def telling_orders(curves: BenchCurves) -> tuple[int, ...]:
    """Orders by which the currents of phase a differ, the largest difference first."""
    difference = np.abs(curves.harmonics[1] - curves.harmonics[0])[: HIGHEST_ORDER + 1]
    return tuple(int(order) for order in np.argsort(-difference)[:4])
