"""What is said of observers of position and speed: ranges, errors, what was learned, for tables,
the report and JSON.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.observers.judgement import (
    ANGLE_LIMIT,
    DEAD_TIME,
    EXACT_DATA,
    SPEED_LIMIT,
    ObserverJudgement,
)
from dqforge.reports.pages.answer import Table

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.optimizer.observers.parts import Disturbances
    from dqforge.optimizer.observers.reduced_order import (
        Limits,
        ReducedOrderObserver,
        SpeedErrorSlopes,
        Training,
    )
    from dqforge.optimizer.observers.tuning import ObserverProof, PositionObserver
    from dqforge.reports.plain_data import PlainData

_PARAMETERS = (("R", "r_s"), ("L", "l_q"), ("psi", "psi_pm"))

# Title, columns, rows, notes.
TextTable = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]
_SYMBOLS = {"r_s": "R", "l_d": "L_d", "l_q": "L_q", "psi_pm": "psi_pm"}
_CAUSES = {DEAD_TIME: "dead time", EXACT_DATA: "exact data"}


def _span(low: float, high: float) -> str:
    if math.isnan(low):
        return "at no speed"
    return f"from {low / (2.0 * math.pi):.3g} to {high / (2.0 * math.pi):.3g} Hz (electrical)"


def speed_range_text(observer: PositionObserver) -> str:
    """Speeds at which the observer holds, accelerating and steady, in words."""
    judgement = observer.judgement
    limits = (
        f"errors below {math.degrees(ANGLE_LIMIT):.3g} deg and {100.0 * SPEED_LIMIT:.3g} % of the "
        "speed (r.m.s.)"
    )
    whole = _span(judgement.omega_low, judgement.omega_high)
    steady = _span(judgement.steady_low, judgement.steady_high)
    return f"{limits}: under acceleration {whole}, at constant speed {steady}"


def dead_time_text(known: Disturbances) -> str:
    """What of the dead time is judged, in words."""
    if known.lost == known.lost_least == 0.0:
        return "no dead time"
    if known.lost == -known.lost_least:
        return f"dead time wrong by {known.lost:.3g} V to either side"
    if known.lost_least < known.lost:
        return f"dead time wrong by {known.lost_least:.3g} to {known.lost:.3g} V"
    return f"dead time not compensated ({known.lost:.3g} V)"


def error_text(known: Disturbances, name: str) -> str:
    """By how much a parameter may be wrong: to either side, or from one figure to another."""
    least, most = known.limits(name)
    return (
        f"{100.0 * most:.3g} %"
        if most == -least
        else f"{100.0 * least:.3g} to {100.0 * most:.3g} %"
    )


def included_text(observer: PositionObserver) -> str:
    """What the errors of the stated range include, in words."""
    known = observer.disturbances
    parts = (
        ", ".join(f"{symbol} {error_text(known, name)}" for symbol, name in _PARAMETERS) + " wrong"
    )
    noise = f"noise of {known.i_noise:.3g} A and {known.v_noise:.3g} V r.m.s."
    if known.loads:
        pairs = dict.fromkeys(
            f"{load.i_d + 0.0:.3g}, {abs(load.i_q):.3g} A" for load in known.loads
        )
        loads = f"loads of (i_d, |i_q|) = {'; '.join(pairs)}, motoring and braking"
    else:
        loads = f"i_q = {known.i_load:.4g} A"
    return (
        f"{parts}; {dead_time_text(known)}; {noise}; {loads}; acceleration of "
        f"{known.acceleration:.3g} rad/s^2"
    )


def tuning_text(observer: PositionObserver) -> str:
    """By what numbers the observer was tuned, in words."""
    return observer.method.in_words(observer.tuning, observer.gains, observer.t_s)


def _degrees(value: float) -> str:
    """An angle in deg; what is below 1e-4 deg is rounding, which differs between processors."""
    return f"{round(math.degrees(value), 4) + 0.0:+.3g}" if math.isfinite(value) else "lost"


def _size(value: float) -> str:
    return f"{math.degrees(value):.3g}" if math.isfinite(value) else "lost"


def rounded_up(factor: float) -> float:
    """A bound with five decimals, which stays one, and is the same on every computer."""
    return math.ceil(factor * 1e5) / 1e5


def proof_text(proof: ObserverProof) -> str:
    """What is proven over the speed range, in one line."""
    low, high = (value / (2.0 * math.pi) for value in (proof.omega_low, proof.omega_high))
    span = f"{low:.3g} to {high:.3g} Hz, |i_q| up to {proof.i_q:.3g} A"
    if not proof.searched:
        return f"nothing is proven for {span}: {proof.reason}"
    if proof.contraction is None:
        return f"no common Lyapunov function was found for {span}: {proof.reason}"
    factor = rounded_up(proof.contraction)
    shrinks = f"small errors shrink by {factor:.5f} per sample or faster while the speed"
    if not proof.points:
        return f"proven: {shrinks} varies in {span}"
    return f"one norm for all: {shrinks} varies in {span}; checked at {proof.points} points"


def plain_proof(proof: ObserverProof) -> PlainData:
    """What is proven, in SI units; a contraction as it is printed."""
    found = proof.contraction
    plain = asdict(proof) | {"contraction": None if found is None else rounded_up(found)}
    return {name: value for name, value in plain.items() if name != "matrix"}


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


# What is said of a correction that was learned: what it gains, and where it knows nothing.


def _hertz(omega: float) -> str:
    return f"{omega / (2.0 * math.pi):.3g}"


def _per_cent(limits: Limits) -> str:
    low, high = limits
    return f"{100.0 * low:+.3g} to {100.0 * high:+.3g} %"


def silence_text(training: Training) -> str:
    """Where the correction is nought, in words."""
    box = training.box
    return (
        f"no correction below {_hertz(box.omega_low)} Hz, where nothing can be learned, above "
        f"{_hertz(box.omega_high)} Hz, beyond {1.05 * box.i_max:.3g} A, and wherever psi^ - "
        "psi_model is beyond what was trained"
    )


def bound_text(training: Training) -> str:
    """How large the correction can become, in words."""
    limit = f"limited to {math.degrees(training.limit):.3g} deg"
    if training.rules is None:
        return f"{limit}: nothing more is proven of a network"
    return (
        f"{limit}; the mean of the rules is within {math.degrees(training.rules):.3g} deg, the "
        "largest of them over the trained ranges"
    )


def training_part(training: Training) -> TextTable:
    """Errors with and without the correction per band of speeds, as a text table."""
    alone, *others = training.rms

    def both(name: str, band: int) -> str:
        rms, largest = training.rms[name][band], training.largest[name][band]
        return f"{math.degrees(rms):.3g} ({math.degrees(largest):.3g})"

    corrected = others[-1]
    rows = tuple(
        (
            f"{_hertz(low)} to {_hertz(high)}",
            *(both(name, k) for name in (alone, *others)),
            f"{100.0 * training.inside[k]:.3g} %",
            f"{100.0 * training.held[k]:.3g} %",
            f"{math.degrees(training.outside[alone][k]):.3g}",
            f"{math.degrees(training.outside[corrected][k]):.3g}",
            f"{100.0 * training.inside_beyond[k]:.3g} %",
        )
        for k, (low, high) in enumerate(training.edges.tolist())
    )
    beyond = f"R {_per_cent(training.beyond)}"
    columns = (
        "electrical Hz",
        alone,
        *others,
        "acts",
        "steady state",
        f"{beyond}: alone",
        corrected,
        "acts",
    )
    box = training.box
    notes = (
        (
            f"{training.numbers} numbers learned of {training.points} steady states: R "
            f"{_per_cent(box.r_s)}, L_d {_per_cent(box.l_d)}, L_q {_per_cent(box.l_q)}, psi_pm "
            f"{_per_cent(box.psi_pm)}, {box.lost[0]:.3g} to {box.lost[1]:.3g} V lost"
        ),
        silence_text(training),
        bound_text(training),
        "transients were neither trained nor tried; the speed is that of the flux observer",
    )
    title = (
        "Learned correction: angle error in deg r.m.s. (largest) on drives of the box that were "
        "not trained"
    )
    return title, columns, rows, notes


def plain_training(training: Training | None) -> PlainData:
    """The same as plain data, angles in rad; nothing of an observer that learns nothing."""
    if training is None:
        return {}

    def plain(values: dict[str, FloatArray]) -> PlainData:
        return {name.replace(" ", "_"): value for name, value in values.items()}

    return {
        "training": {
            "box": asdict(training.box),
            "edges_rad_per_s": training.edges,
            "rms_rad": plain(training.rms),
            "largest_rad": plain(training.largest),
            "beyond_r_s": training.beyond,
            "beyond_rms_rad": plain(training.outside),
            "held": training.held,
            "acts": training.inside,
            "acts_beyond": training.inside_beyond,
            "limit_rad": training.limit,
            "rules_rad": training.rules,
            "numbers": training.numbers,
            "points": training.points,
        }
    }


def factor_text(slopes: SpeedErrorSlopes) -> str:
    """What is proven of the error of the speed observer, in one line."""
    factor = rounded_up(slopes.contraction)
    span = "at every speed, i_d up to the current limit and v_d up to the linear range"
    if factor < 1.0:
        return f"proven: an error shrinks by {factor:.5f} per sample or faster {span}"
    return f"an error need not shrink {span}: its factor per sample is up to {factor:.5f}"


def observer_table(observer: ReducedOrderObserver, slopes: SpeedErrorSlopes) -> Table:
    """The speed observer as a table of the terminal."""
    rows = (
        ("A", f"{observer.a:.7g}", ""),
        ("B_U", f"{observer.b_u:.7g}", "rad/(s V)"),
        ("B_I", f"{observer.b_i:.7g}", "rad/(s A)"),
        ("C", f"{observer.c:.7g}", "rad/(s A)"),
    )
    wrong = 100.0 * slopes.r_error
    notes = (
        "steady speed error: none with exact parameters and no load;",
        f"an unknown load torque shifts the estimate by {in_rpm(slopes.load):.3g} rpm per N m,",
        (
            f"a resistance that is {wrong:.0f} % too high by {in_rpm(slopes.resistance):.3g} rpm "
            "per A of i_q"
        ),
        factor_text(slopes),
    )
    return Table(
        "Speed observer: omega_hat = zeta - C i_q; zeta' = A zeta + B_U u_q + B_I i_q",
        ("", "value", "unit"),
        rows,
        notes,
    )
