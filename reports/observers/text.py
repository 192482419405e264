"""What is said of a position observer: poles, speed range and errors, for tables,
the report and JSON.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.optimizer.observers.judgement import (
    ANGLE_LIMIT,
    DEAD_TIME,
    EXACT_DATA,
    SPEED_LIMIT,
    ObserverJudgement,
)
from dqforge.reports.observers.position_header import (
    error_text,
    included_text,
    speed_range_text,
    tuning_text,
)
from dqforge.reports.observers.training_text import plain_training, training_part

if TYPE_CHECKING:
    from dqforge.optimizer.observers.proof import ObserverProof
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.optimizer.observers.tuning_numbers import Disturbances
    from dqforge.reports.plain_data import PlainData

# Title, columns, rows, notes.
TextTable = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]
_SYMBOLS = {"r_s": "R", "l_d": "L_d", "l_q": "L_q", "psi_pm": "psi_pm"}
_CAUSES = {DEAD_TIME: "dead time", EXACT_DATA: "exact data"}


def _degrees(value: float) -> str:
    """An angle in deg; what is below 1e-4 deg is rounding, which differs between processors."""
    return f"{round(math.degrees(value), 4) + 0.0:+.3g}" if math.isfinite(value) else "lost"


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
        f"proven: small errors shrink by {proof.contraction:.5f} per sample or faster while the "
        f"speed varies in {span}"
    )


def _cause(name: str, known: Disturbances) -> str:
    """Heading of a cause."""
    if name in _SYMBOLS:
        least, most = known.limits(name)
        return f"{_SYMBOLS[name]} {'+-' if most == -least else ''}{error_text(known, name)}"
    return _CAUSES[name]


def _angle_part(observer: PositionObserver, proof: ObserverProof | None) -> TextTable:
    known, judged = observer.disturbances, observer.shown
    names = tuple(judged.bias)
    columns = (
        "electrical Hz",
        *(_cause(name, known) for name in names),
        "noise r.m.s.",
        "steady",
        "acceleration",
        "together",
        "largest pole",
    )
    rows = tuple(
        (
            f"{judged.omega[s] / (2.0 * math.pi):.4g}",
            *(_degrees(float(judged.bias[name][s])) for name in names),
            _size(float(judged.noise[s])),
            _size(float(judged.steady[s])),
            _degrees(float(judged.lag[s])),
            _size(float(judged.total[s])),
            f"{judged.radius[s]:.5f}",
        )
        for s in range(len(judged.omega))
    )
    notes: tuple[str, ...] = (
        tuning_text(observer),
        speed_range_text(observer),
        f"included: {included_text(observer)}",
        (
            "at the worst load; steady: root of the squares of all before it, together: with the "
            "acceleration"
        ),
    )
    if proof is not None:
        notes = (*notes, proof_text(proof))
    return (
        f"Position observer: {observer.method.title}; angle error in deg (electrical)",
        columns,
        rows,
        notes,
    )


def _speed_part(observer: PositionObserver) -> TextTable:
    known, judged = observer.disturbances, observer.shown
    names = tuple(judged.speed_bias)

    def per_cent(value: float, omega: float, sign: str = "+") -> str:
        # adding zero turns -0 into 0
        return (
            f"{round(100.0 * value / omega, 2) + 0.0:{sign}.3g}" if math.isfinite(value) else "lost"
        )

    rows = tuple(
        (
            f"{omega / (2.0 * math.pi):.4g}",
            *(per_cent(float(judged.speed_bias[name][s]), omega) for name in names),
            per_cent(float(judged.speed_total[s]), omega, ""),
        )
        for s, omega in enumerate(judged.omega.tolist())
    )
    columns = ("electrical Hz", *(_cause(name, known) for name in names), "together")
    title = f"Position observer: {observer.method.title}; steady error of the speed in % of it"
    return title, columns, rows, ("at the worst load; together: root of the squares",)


def position_parts(
    observer: PositionObserver, proof: ObserverProof | None = None
) -> list[TextTable]:
    """Errors of angle and speed over the speed, the tuning, what is proven, and what was learned,
    as text tables.
    """
    learned = [] if observer.training is None else [training_part(observer.training)]
    return [_angle_part(observer, proof), _speed_part(observer), *learned]


def plain_position(observer: PositionObserver) -> PlainData:
    """Method, tuning, gains, assumptions, and errors and poles over the speed,
    in SI units and rad.
    """
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
        "steady_low_rad_per_s": judgement.steady_low,
        "steady_high_rad_per_s": judgement.steady_high,
        "angle_limit_rad": ANGLE_LIMIT,
        "speed_limit": SPEED_LIMIT,
        "bias_rad": judgement.bias,
        "speed_bias_rad_per_s": judgement.speed_bias,
        "speed_total_rad_per_s": judgement.speed_total,
        "steady_rad": judgement.steady,
        "lag_rad": judgement.lag,
        "noise_rad": judgement.noise,
        "total_rad": judgement.total,
        "poles": [[[pole.real, pole.imag] for pole in row] for row in judgement.poles.tolist()],
        "shown": _plain_shown(observer.shown),
        **plain_training(observer.training),
    }


def _plain_shown(judged: ObserverJudgement) -> PlainData:
    """What the tables show: errors at a few speeds, in rad and rad/s."""
    return {
        "omega_rad_per_s": judged.omega,
        "bias_rad": judged.bias,
        "noise_rad": judged.noise,
        "steady_rad": judged.steady,
        "lag_rad": judged.lag,
        "total_rad": judged.total,
        "largest_pole": judged.radius,
        "speed_bias_rad_per_s": judged.speed_bias,
        "speed_total_rad_per_s": judged.speed_total,
    }
