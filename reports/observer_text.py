"""What is said of a position observer: poles, speed range and errors, for tables, the report and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from dqforge.optimizer.observer_judgement import judge_at
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


def position_parts(observer: PositionObserver) -> list[TextTable]:
    """Angle errors over the speed, and the tuning, as text tables."""
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
    notes = (
        tuning_text(observer),
        f"holds from {speed_range_text(observer)}",
        f"i_q = {known.i_load:.3g} A, acceleration {known.acceleration:.3g} rad/s^2 (electrical), {noise}",
    )
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
