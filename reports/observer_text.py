"""What is said of a position observer: poles, speed range and errors, for tables, the report and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from dqforge.optimizer.observer_judgement import judge_at
from dqforge.optimizer.observer_proof import ObserverProof
from dqforge.optimizer.observer_tuning import PositionObserver
from dqforge.reports.observer_header import speed_range_text, tuning_text
from dqforge.reports.reference_ir import PlainData

TextTable = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]
"""Title, columns, rows, notes."""

_SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)
_SYMBOLS = {"r_s": "R", "l_d": "L_d", "l_q": "L_q", "psi_pm": "psi_pm"}


def _degrees(value: float) -> str:
    return f"{math.degrees(value):+.3g}" if math.isfinite(value) else "lost"


def _size(value: float) -> str:
    return f"{math.degrees(value):.3g}" if math.isfinite(value) else "lost"


def proof_text(proof: ObserverProof) -> str:
    """What is proven over the speed range, in one line."""
    low, high = (value / (2.0 * math.pi) for value in (proof.omega_low, proof.omega_high))
    span = f"{low:.3g} to {high:.3g} Hz, |i_q| up to {proof.i_q:.3g} A"
    if not proof.searched:
        return f"nothing is proven for {span}: {proof.reason}"
    if proof.contraction is None:
        return f"no common Lyapunov function was found for {span}: {proof.reason}"
    return (
        f"proven: small errors shrink by {proof.contraction:.5f} per sample or faster while the speed varies in {span}"
    )


def position_parts(observer: PositionObserver, proof: ObserverProof | None = None) -> list[TextTable]:
    """Angle errors over the speed, the tuning, and what is proven, as text tables."""
    known = observer.disturbances
    omega = np.array(_SHARES) * observer.omega_max
    judged = judge_at(observer.method, observer.gains, observer.t_s, observer.machine, known, omega)
    names = tuple(judged.bias)
    columns = (
        "electrical Hz",
        *(f"{_SYMBOLS[name]} +-{100.0 * getattr(known, name):.3g} %" for name in names),
        "acceleration",
        "noise r.m.s.",
        "together",
        "largest pole",
    )
    rows = tuple(
        (
            f"{omega[s] / (2.0 * math.pi):.4g}",
            *(_degrees(float(judged.bias[name][s])) for name in names),
            _degrees(float(judged.lag[s])),
            _size(float(judged.noise[s])),
            _size(float(judged.total[s])),
            f"{judged.radius[s]:.5f}",
        )
        for s in range(len(omega))
    )
    noise = f"noise {known.i_noise:.2g} A and {known.v_noise:.2g} V r.m.s."
    notes: tuple[str, ...] = (
        tuning_text(observer),
        f"holds from {speed_range_text(observer)}",
        f"i_q = {known.i_load:.3g} A, acceleration {known.acceleration:.3g} rad/s^2 (electrical), {noise}",
    )
    if proof is not None:
        notes = (*notes, proof_text(proof))
    return [(f"Position observer: {observer.method.title}; angle error in deg (electrical)", columns, rows, notes)]


def plain_position(observer: PositionObserver) -> PlainData:
    """Method, tuning, gains, assumptions, and errors and poles over the speed, in SI units and rad."""
    judgement = observer.judgement
    return {
        "method": observer.method.name,
        "t_s": observer.t_s,
        "tuning": asdict(observer.tuning),
        "gains": asdict(observer.gains),
        "disturbances": asdict(observer.disturbances),
        "omega_low_rad_per_s": judgement.omega_low,
        "omega_high_rad_per_s": judgement.omega_high,
        "omega_rad_per_s": judgement.omega,
        "bias_rad": judgement.bias,
        "lag_rad": judgement.lag,
        "noise_rad": judgement.noise,
        "total_rad": judgement.total,
        "poles": [[[pole.real, pole.imag] for pole in row] for row in judgement.poles.tolist()],
    }
