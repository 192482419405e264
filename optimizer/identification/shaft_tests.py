"""Runs with the shaft driven, locked or free: encoder offset, speed per volt, torque per ampere,
friction of a coasting rotor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.columns import BemfResult
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import (
    SUPPORTED,
    Regression,
    averaged,
    correlation_time,
    mean_of,
    regress,
)
from dqforge.optimizer.identification.parameters import (
    Analysis,
    Parameter,
    RunResiduals,
    compared,
    judged,
    student_95,
    unknown,
    with_partners,
)


def _left(run: str, quantity: str, unit: str, fit: Regression) -> RunResiduals:
    rows = fit.residuals.size
    return RunResiduals(run, quantity, unit, fit.rms, rows, fit.effective, fit.residuals)


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Integral over the time from the first row on, by straight lines."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (values[1:] + values[:-1]))])


def _one_series(rows: int) -> NDArray[np.intp]:
    return np.zeros(rows, dtype=np.intp)


# Encoder offset, from the voltages without current while the shaft is driven at a constant speed
# and the offset of the encoder is swept over a turn.
#
# With x the offset and x0 the right one, psi_d + j psi_q = psi_pm exp(-j (x0 - x)) in the frame of
# the encoder: psi_d = psi_pm cos(x - x0), psi_q = psi_pm sin(x - x0), and u = j w psi. Delay of the
# voltage against the angle, and iron loss, turn the voltage in the sense of rotation: what one
# direction calls the offset holds them, the mean of both does not.


@dataclass(frozen=True, slots=True)
class OffsetCurve:
    """One quantity over the offset: rad and V (or V s), shape (N,)."""

    quantity: str
    offset: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class OffsetSweep:
    """A sweep at one speed of the shaft, rad/s with its sign."""

    run: str
    omega_m: float
    curves: tuple[OffsetCurve, ...]


@dataclass(frozen=True, slots=True)
class _Circle:
    """Amplitude and phase of a curve, with their standard deviations and freedom."""

    amplitude: float
    amplitude_sigma: float
    phase: float
    phase_sigma: float
    fit: Regression


# What is added to the phase of each quantity to be that of psi_d, for a positive speed, in rad.
_LEADS = {"psi_d": 0.0, "psi_q": -0.5 * math.pi, "u_q": 0.0, "u_d": 0.5 * math.pi}
# Harmonics of the machine and of the encoder stay in the residuals.
_LEAST_TURN = 0.75 * 2.0 * math.pi


def _circle(curve: OffsetCurve) -> _Circle:
    order = np.argsort(curve.offset, kind="stable")
    x, values = curve.offset[order], curve.values[order]
    rows = np.column_stack([np.ones_like(x), np.cos(x), np.sin(x)])
    fit = regress(rows, values, _one_series(x.size))
    cosine, sine = fit.coefficients[1:]
    amplitude = math.hypot(cosine, sine)
    along = np.array([cosine, sine]) / amplitude
    across = np.array([-sine, cosine]) / amplitude**2
    covariance = fit.covariance[1:, 1:]
    return _Circle(
        amplitude,
        math.sqrt(float(along @ covariance @ along)),
        math.atan2(sine, cosine),
        math.sqrt(float(across @ covariance @ across)),
        fit,
    )


def offset_fault(sweep: OffsetSweep) -> str:
    """Why a sweep of the offset says nothing, '' where it does."""
    if sweep.omega_m == 0.0:
        return "the shaft stands still; drive it"
    for curve in sweep.curves:
        if np.ptp(curve.values) == 0.0:
            return f"{curve.quantity} is the same at all offsets"
        if curve.offset.size < 8 or float(np.ptp(curve.offset)) < _LEAST_TURN:
            turn = math.degrees(float(np.ptp(curve.offset)))
            return f"the offset is swept over {turn:.0f} deg; a circle needs 270 deg"
    return ""


def _weighted(values: Sequence[float], sigmas: Sequence[float]) -> tuple[float, float]:
    """Mean by inverse variance and its standard deviation, widened where they differ by more."""
    weights = np.array(sigmas) ** -2.0
    mean = float(weights @ np.array(values) / weights.sum())
    sigma = float(weights.sum() ** -0.5)
    if len(values) > 1:
        chi2 = float(np.sum(weights * (np.array(values) - mean) ** 2)) / (len(values) - 1)
        sigma *= max(1.0, math.sqrt(chi2))
    return mean, sigma


def _offset_of(sweep: OffsetSweep, circles: Sequence[_Circle]) -> tuple[float, float]:
    """Offset that one direction alone would give, rad, and its standard deviation."""
    turn = 1.0 if sweep.omega_m > 0.0 else -1.0
    offsets = []
    for curve, circle in zip(sweep.curves, circles, strict=True):
        # A voltage has the sign of the speed: half a turn for a negative one.
        half = math.pi if curve.quantity.startswith("u") and turn < 0.0 else 0.0
        offsets.append(circle.phase + _LEADS[curve.quantity] + half)
    first = offsets[0]
    near = [first + math.remainder(one - first, 2.0 * math.pi) for one in offsets]
    mean, sigma = _weighted(near, [circle.phase_sigma for circle in circles])
    return math.remainder(mean, 2.0 * math.pi), sigma


_OFFSET = ("encoder_offset", "offset of the encoder", "rad")
_TURNED = ("voltage_turn", "turn of the voltage by delay and iron loss", "rad")


def analyse_offsets(
    sweeps: Sequence[OffsetSweep], pole_pairs: int, known_flux: tuple[float, str] | None
) -> Analysis:
    """Encoder offset, magnet flux linkage and number of pole pairs of sweeps that `offset_fault`
    has nothing against.
    """
    circles = [[_circle(curve) for curve in sweep.curves] for sweep in sweeps]
    remarks: list[str] = []
    contradictions: list[str] = []
    fluxes, parameters = [], []
    for sweep, found in zip(sweeps, circles, strict=True):
        value, sigma = _flux_of(sweep, found, pole_pairs)
        fluxes.append((value, sigma))
        remarks += _pole_pairs_told(sweep, found, pole_pairs, contradictions)
    runs = tuple(sweep.run for sweep in sweeps)
    freedom = min(circle.fit.freedom for found in circles for circle in found)
    mean, sigma = _weighted([one for one, _ in fluxes], [one for _, one in fluxes])
    flux = judged(("magnet_flux", "magnet flux linkage", "Wb"), mean, sigma, freedom, runs=runs)
    parameters.append(flux)
    offsets = [_offset_of(*pair) for pair in zip(sweeps, circles, strict=True)]
    parameters += _offsets(sweeps, offsets, freedom, remarks)
    if len(sweeps) > 1:
        values = [one for one, _ in fluxes]
        gap = (max(values) - min(values)) / mean
        remarks.append(f"the magnet flux linkage of the runs differs by {100.0 * gap:.2f} %")
    if known_flux is not None:
        text, against = compared(flux, *known_flux)
        if text:
            (contradictions if against else remarks).append(text)
    left = tuple(
        _left(sweep.run, curve.quantity, "V" if curve.quantity.startswith("u") else "Wb", one.fit)
        for sweep, found in zip(sweeps, circles, strict=True)
        for curve, one in zip(sweep.curves, found, strict=True)
    )
    covariance = np.diag([one.sigma**2 for one in parameters])
    terms = ("a circle over the offset, with a constant",)
    return Analysis(
        "offset-sweep",
        tuple(parameters),
        covariance,
        left,
        tuple(remarks),
        tuple(contradictions),
        terms,
    )


def _flux_of(
    sweep: OffsetSweep, circles: Sequence[_Circle], pole_pairs: int
) -> tuple[float, float]:
    """Magnet flux linkage of a sweep in Wb by its voltages, else by its flux linkages."""
    omega_e = pole_pairs * abs(sweep.omega_m)
    pairs = list(zip(sweep.curves, circles, strict=True))
    voltages = [one for curve, one in pairs if curve.quantity.startswith("u")]
    scale = omega_e if voltages else 1.0
    used = voltages or list(circles)
    return _weighted(
        [one.amplitude / scale for one in used], [one.amplitude_sigma / scale for one in used]
    )


def _pole_pairs_told(
    sweep: OffsetSweep, circles: Sequence[_Circle], pole_pairs: int, contradictions: list[str]
) -> list[str]:
    """Pole pairs by voltage over flux linkage, where both were logged."""
    pairs = list(zip(sweep.curves, circles, strict=True))
    voltages = [one for curve, one in pairs if curve.quantity.startswith("u")]
    linkages = [one for curve, one in pairs if curve.quantity.startswith("psi")]
    if not voltages or not linkages:
        return []
    over, over_sigma = _weighted(
        [one.amplitude for one in voltages], [one.amplitude_sigma for one in voltages]
    )
    under, under_sigma = _weighted(
        [one.amplitude for one in linkages], [one.amplitude_sigma for one in linkages]
    )
    found = over / under / abs(sweep.omega_m)
    sigma = found * math.hypot(over_sigma / over, under_sigma / under)
    text = (
        f"{sweep.run}: voltage over flux linkage gives {found:.3f} +- {sigma:.3f} pole pairs (one "
        "standard deviation)"
    )
    if round(found) != pole_pairs:
        contradictions.append(f"{text}, not {pole_pairs}")
        return []
    return [text]


def _offsets(
    sweeps: Sequence[OffsetSweep],
    offsets: Sequence[tuple[float, float]],
    freedom: float,
    remarks: list[str],
) -> list[Parameter]:
    """Offset and turn of the voltage, of both directions."""
    sides = [
        [one for sweep, one in zip(sweeps, offsets, strict=True) if (sweep.omega_m > 0.0) is side]
        for side in (True, False)
    ]
    if not all(sides):
        reason = (
            "one direction of rotation: delay and iron loss turn the voltage, and look like an "
            "offset; drive the shaft the other way too"
        )
        return [unknown(_OFFSET, reason), unknown(_TURNED, reason)]
    runs = tuple(sweep.run for sweep in sweeps)
    (ahead, ahead_sigma), (back, back_sigma) = (
        _weighted([one for one, _ in side], [one for _, one in side]) for side in sides
    )
    back = ahead + math.remainder(back - ahead, 2.0 * math.pi)
    sigma = 0.5 * math.hypot(ahead_sigma, back_sigma)
    turn = 0.5 * (back - ahead)
    speed = float(np.mean([abs(sweep.omega_m) for sweep in sweeps]))
    remarks.append(
        f"each direction alone gives an offset of {ahead:.4f} and {back:.4f} rad: "
        f"+-{abs(math.degrees(turn)):.2f} deg of delay or iron loss at {speed * 30 / math.pi:.0f} "
        "rpm, which one speed does not tell apart"
    )
    values = (
        judged(_OFFSET, 0.5 * (ahead + back), sigma, freedom, runs=runs, may_vanish=True),
        judged(_TURNED, turn, sigma, freedom, runs=runs, may_vanish=True),
    )
    return list(values)


# Speed per volt, from steps of a direct voltage with the shaft free.


@dataclass(frozen=True, slots=True)
class VoltageSteps:
    """Rows of a run: time (s), voltage (V) and speed of the shaft (rad/s), shape (N,)."""

    run: str
    time: FloatArray
    voltage: FloatArray
    omega_m: FloatArray


# Rows after a step that are left out, as a number of the time in which the speed has come to half.
_SETTLING = 8.0
_LEAST_PLATEAU = 3
_GAIN = ("speed_per_volt", "speed per volt", "rad/s/V")
_LAG = ("time_constant", "mechanical time constant", "s")
_DROP = ("friction_voltage", "voltage that friction takes", "V")


def _plateaus(steps: VoltageSteps) -> list[NDArray[np.intp]]:
    """Rows of constant voltage other than zero, without those in which the speed still changes."""
    found = []
    voltage = steps.voltage
    edges = np.flatnonzero(np.abs(np.diff(voltage)) > 1e-3 * float(np.max(np.abs(voltage)))) + 1
    for part in np.split(np.arange(voltage.size), edges):
        if part.size < _LEAST_PLATEAU or abs(float(voltage[part[0]])) < 1e-9:
            continue
        final = float(np.median(steps.omega_m[part[part.size // 2 :]]))
        start = float(steps.omega_m[part[0]])
        away = np.abs(steps.omega_m[part] - final)
        late = np.flatnonzero(away <= 0.5 * abs(start - final))
        half = float(steps.time[part[late[0]]] - steps.time[part[0]]) if late.size else 0.0
        settled = steps.time[part] >= steps.time[part[0]] + _SETTLING * half
        kept = part[settled & (np.arange(part.size) >= 1)]
        if kept.size >= _LEAST_PLATEAU:
            found.append(kept)
    return found


def steps_fault(steps: VoltageSteps) -> str:
    """Why steps say nothing, '' where they do."""
    if not _plateaus(steps):
        return "the voltage stays nowhere long enough for a steady speed; hold each level longer"
    return ""


def analyse_steps(runs: Sequence[VoltageSteps]) -> Analysis:
    """Speed per volt of runs that `steps_fault` has nothing against."""
    gains, left, levels = [], [], set()
    for steps in runs:
        kept = np.concatenate(_plateaus(steps))
        fit = regress(steps.voltage[kept][:, None], steps.omega_m[kept], _one_series(kept.size))
        gains.append((float(fit.coefficients[0]), math.sqrt(fit.covariance[0, 0]), fit.freedom))
        left.append(_left(steps.run, "speed", "rad/s", fit))
        levels |= {round(float(level), 3) for level in np.abs(steps.voltage[kept])}
    names = tuple(steps.run for steps in runs)
    values = np.array([one for one, _, _ in gains])
    mean, sigma = float(values.mean()), gains[0][1]
    freedom = gains[0][2]
    if len(runs) > 1:
        # The runs differ by more than each one's errors: their scatter is the uncertainty.
        sigma = max(
            float(values.std(ddof=1)) / math.sqrt(values.size),
            float(np.mean([one for _, one, _ in gains])) / math.sqrt(values.size),
        )
        freedom = float(values.size - 1)
    gain = judged(_GAIN, mean, sigma, freedom, runs=names)
    interval = float(np.median(np.diff(runs[0].time)))
    remarks = _drift_told(names, values)
    one_level = len(levels) < 2
    lag = f"rows are {1e3 * interval:.2g} ms apart, and the speed settles within a few of them"
    drop = (
        f"one voltage ({max(levels):.3g} V): friction and speed per volt are one number; run "
        "another"
    )
    absent = (
        unknown(_LAG, lag),
        unknown(_DROP, drop if one_level else "not evaluated from steady speeds of free shafts"),
    )
    parameters = (gain, *absent)
    covariance = np.full((3, 3), np.nan)
    covariance[0, 0] = sigma**2
    return Analysis("voltage-speed", parameters, covariance, tuple(left), tuple(remarks))


def _drift_told(names: Sequence[str], values: FloatArray) -> list[str]:
    if values.size < 2:
        return ["one run: friction that warms changes the speed per volt from run to run; repeat"]
    share = 100.0 * (values[-1] / values[0] - 1.0)
    steps = np.diff(values)
    way = (
        "rising all the way"
        if (steps > 0).all()
        else "falling all the way"
        if (steps < 0).all()
        else "up and down"
    )
    return [
        (
            f"from {names[0]} to {names[-1]} the speed per volt changes by {share:+.2f} %, {way}: "
            "the interval is that of the runs, not of their rows"
        )
    ]


# Torque per ampere, from bursts of current into a locked machine.


@dataclass(frozen=True, slots=True)
class Bursts:
    """Rows of a run: time (s), current (A) and torque (N m), shape (N,)."""

    run: str
    time: FloatArray
    current: FloatArray
    torque: FloatArray


_ON = 0.9
_OFF = 0.1
_EDGES = 0.1
_AHEAD = 0.2
_PLATEAU = 0.05
# The torque of a burst must exceed what the sensor shows without current by this many times.
_ALIVE = 5.0
_KT = ("torque_constant", "torque per ampere of the q axis", "N m/A")


def _burst_rows(bursts: Bursts) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of full current without a tenth at both ends of a burst, and rows without current."""
    size = np.abs(bursts.current)
    level = float(np.quantile(size, 0.95))
    high = size > _ON * level
    parts = np.split(np.arange(size.size), np.flatnonzero(np.diff(high)) + 1)
    kept = []
    for part in parts:
        if high[part[0]]:
            cut = max(1, round(_EDGES * part.size))
            kept.append(part[cut : part.size - cut])
    first = int(np.flatnonzero(high)[0]) if high.any() else size.size
    # Current and torque come by different channels, and the torque may be logged first.
    longest = max((part.size for part in parts if high[part[0]]), default=0)
    before = np.arange(size.size) < first - round(_AHEAD * longest)
    rest = np.flatnonzero((size < _OFF * level) & before)
    return (np.concatenate(kept) if kept else np.empty(0, dtype=np.intp)), rest


def bursts_fault(bursts: Bursts) -> str:
    """Why bursts say nothing, '' where they do."""
    on, off = _burst_rows(bursts)
    if on.size < 5 or off.size < 5:
        return "no burst of current with rows without current before it"
    quiet, loud = (float(np.median(bursts.torque[rows])) for rows in (off, on))
    noise = 1.5 * float(np.median(np.abs(bursts.torque[off] - quiet)))
    if abs(loud - quiet) < _ALIVE * noise:
        return (
            f"the torque changes by {1e3 * abs(loud - quiet):.2g} mN m with "
            f"{np.median(bursts.current[on]):.3g} A, {1e3 * noise:.2g} mN m of noise: the torque "
            "sensor does not answer; repair it"
        )
    return ""


def analyse_bursts(
    bursts: Bursts, pole_pairs: int, known_flux: tuple[float, str] | None
) -> Analysis:
    """Torque per ampere of bursts that `bursts_fault` has nothing against.

    The torque of a locked machine at i_d = 0 is 1.5 p psi_pm i_q.
    """
    on, off = _burst_rows(bursts)
    # The torque may come and go before the current that the log has beside it.
    level = float(np.median(bursts.torque[on]))
    on = on[np.abs(bursts.torque[on] - level) < _PLATEAU * abs(level)]
    zero, zero_sigma, _ = mean_of(bursts.torque[off])
    current, current_sigma, _ = mean_of(bursts.current[on])
    torque, torque_sigma, freedom = mean_of(bursts.torque[on])
    constant = (torque - zero) / current
    sigma = abs(constant) * math.hypot(
        math.hypot(torque_sigma, zero_sigma) / (torque - zero), current_sigma / current
    )
    found = judged(_KT, constant, sigma, freedom, runs=(bursts.run,))
    count = int(np.sum(np.diff(np.concatenate([[0], on])) > 1))
    remarks = [
        (
            f"{bursts.run}: {1e3 * (torque - zero):.4g} mN m at {current:.4g} A, less "
            f"{1e3 * zero:.2g} mN m without current"
        ),
        (
            f"{bursts.run}: one position of the rotor and {'one burst' if count < 2 else 'bursts'}:"
            " cogging, gain of the sensor and lever are not in the interval"
        ),
    ]
    contradictions: list[str] = []
    if known_flux is not None:
        flux, origin = known_flux
        text, against = compared(found, torque_per_ampere(pole_pairs, flux), origin)
        (contradictions if against else remarks).append(f"{bursts.run}: {text}")
    values = bursts.torque[on]
    time = correlation_time(values - values.mean(), _one_series(values.size))
    left = RunResiduals(
        bursts.run,
        "torque",
        "N m",
        float(values.std(ddof=1)),
        values.size,
        values.size / time,
        values - values.mean(),
    )
    return Analysis(
        "locked-torque",
        (found,),
        np.array([[sigma**2]]),
        (left,),
        tuple(remarks),
        tuple(contradictions),
    )


# Magnet flux linkage, from a capture of the open terminals.


def captured(run: str, capture: BemfResult, known_flux: tuple[float, str] | None) -> Analysis:
    """What a capture of the back-EMF holds, with its own interval."""
    value = capture.psi_pm
    half = float(np.max(capture.amplitude_uncertainty[:, 0]))
    flux = Parameter(
        "magnet_flux",
        "magnet flux linkage",
        "Wb",
        value,
        value - half,
        value + half,
        half / student_95(math.inf),
        "identified",
        "",
        (),
        (run,),
    )
    remarks = [f"{run}: {text}" for text in capture.findings]
    contradictions: list[str] = []
    if known_flux is not None:
        text, against = compared(flux, *known_flux)
        (contradictions if against else remarks).append(f"{run}: {text}")
    return Analysis(
        "back-emf",
        (flux,),
        np.array([[flux.sigma**2]]),
        (),
        tuple(remarks),
        tuple(contradictions),
        (f"{capture.orders.size} harmonics",),
    )


# Inertia, from a current that accelerates the shaft.


@dataclass(frozen=True, slots=True)
class SpinUp:
    """Rows of a run: time (s), i_q (A) and speed of the shaft (rad/s), shape (N,)."""

    run: str
    time: FloatArray
    i_q: FloatArray
    omega_m: FloatArray


_INERTIA = ("inertia", "moment of inertia", "kg m^2")


def spin_up_fault(spin: SpinUp) -> str:
    """Why an acceleration says nothing, '' where it does."""
    if (np.diff(spin.time) <= 0.0).any():
        return "the times do not rise"
    if np.ptp(spin.omega_m) <= 0.1 * float(np.max(np.abs(spin.omega_m))):
        return "the speed does not change; log the acceleration"
    if not np.any(spin.i_q):
        return "i_q is 0 throughout; coasting is a run of kind spin-down"
    return ""


def analyse_spin_up(spins: Sequence[SpinUp], torque_constant: float, share: float) -> Analysis:
    """Moment of inertia and friction of accelerations that `spin_up_fault` has nothing against, and
    of coasting, whose i_q is 0.

    J dw/dt = k_t i_q - T_c sgn w - b w is fitted in its integral, as of a spin-down. A constant
    acceleration alone does not tell J from T_c: coasting does.

    Args:
        spins: The runs, in any order.
        torque_constant: k_t at i_d = 0 in N m/A.
        share: Its standard deviation as a share.
    """
    parts, values = [], []
    for place, spin in enumerate(spins):
        begin = np.zeros((spin.time.size, len(spins)))
        begin[:, place] = 1.0
        turned = (_integral(spin.time, x) for x in (np.sign(spin.omega_m), spin.omega_m))
        parts.append(np.column_stack([begin, spin.omega_m, *turned]))
        values.append(torque_constant * _integral(spin.time, spin.i_q))
    coasts = any(not np.any(spin.i_q) for spin in spins)
    whole, series = np.concatenate(parts), np.repeat(range(len(spins)), [x.size for x in values])
    count = len(spins)
    base = range(count + (3 if coasts else 1))
    fit = averaged(whole, base, np.concatenate(values), series)
    found, covariance = fit.coefficients[count:], fit.covariance[count:, count:].copy()
    covariance += share**2 * np.outer(found, found)  # of the torque constant, all alike
    runs = tuple(spin.run for spin in spins)
    parameters = [
        judged(
            named,
            float(found[place]),
            math.sqrt(covariance[place, place]),
            fit.best.freedom,
            runs=runs,
        )
        if coasts or place == 0 or fit.included[count + place] > SUPPORTED
        else unknown(named, "an acceleration alone does not tell it from the inertia; let it coast")
        for place, named in enumerate((_INERTIA, _COULOMB, _VISCOUS))
    ]
    driven = next(spin.run for spin in spins if np.any(spin.i_q))
    remark = (
        f"{driven}: with {torque_constant:.4g} N m/A at i_d = 0; whatever else the current turns "
        "is in the inertia"
    )
    left = tuple(
        RunResiduals(
            spin.run,
            "angular momentum",
            "N m s",
            float(np.sqrt(np.mean(own**2))),
            own.size,
            fit.best.effective * own.size / series.size,
            own,
        )
        for place, spin in enumerate(spins)
        for own in (fit.best.residuals[series == place],)
    )
    return Analysis(
        "spin-up", tuple(with_partners(parameters, covariance)), covariance, left, (remark,)
    )


# Friction, from a rotor of known inertia that coasts.


@dataclass(frozen=True, slots=True)
class SpinDown:
    """Rows of a run: time (s) and speed of the shaft (rad/s), shape (N,)."""

    run: str
    time: FloatArray
    omega_m: FloatArray


_COULOMB = ("coulomb_friction", "friction that does not depend on the speed", "N m")
_VISCOUS = ("friction", "viscous friction", "N m s/rad")
_FAN = ("fan_friction", "friction with the square of the speed", "N m s^2/rad^2")
_LEAST_FALL = 0.3


def spin_fault(spin: SpinDown) -> str:
    """Why a spin-down says nothing, '' where it does."""
    speed = np.abs(spin.omega_m)
    if (np.diff(spin.time) <= 0.0).any():
        return "the times do not rise"
    if speed[0] <= 0.0 or np.ptp(speed) == 0.0:
        return "the shaft does not coast: its speed stays, or begins at 0"
    if speed[-1] > (1.0 - _LEAST_FALL) * speed[0]:
        return f"the speed falls by {100 * (1 - speed[-1] / speed[0]):.0f} %; it needs 30 %"
    return ""


def analyse_spin(spin: SpinDown, inertia: float) -> Analysis:
    """Friction of a coasting rotor that `spin_fault` has nothing against.

    J dw/dt = -T_c - b w is fitted in its integral, J (w(t) - w(0)) = -T_c t - b (angle): no slope
    of a noisy speed is taken.
    """
    turn = float(np.sign(spin.omega_m[0]))
    speed, time = turn * spin.omega_m, spin.time - spin.time[0]
    angle, square = _integral(time, speed), _integral(time, speed**2)
    rows = np.column_stack([np.ones_like(time), -time, -angle, -square])
    series = _one_series(time.size)
    fit = regress(rows[:, :3], inertia * speed, series)
    with_fan = regress(rows, inertia * speed, series)
    parameters = [
        judged(
            named,
            float(fit.coefficients[place]),
            math.sqrt(fit.covariance[place, place]),
            fit.freedom,
            runs=(spin.run,),
        )
        for place, named in ((1, _COULOMB), (2, _VISCOUS))
    ]
    covariance = fit.covariance[1:, 1:]
    parameters = with_partners(parameters, covariance)
    fan, fan_sigma = float(with_fan.coefficients[3]), math.sqrt(with_fan.covariance[3, 3])
    half = student_95(with_fan.freedom) * fan_sigma
    remarks = [
        (
            f"{spin.run}: b holds between {speed.min():.3g} and {speed.max():.3g} rad/s; the rows "
            f"count as {fit.effective:.3g} of {time.size}"
        )
    ]
    if fan < 0.0:
        why = f"{fan:.2g} +- {half:.1g}: friction that falls with speed squared is not physical"
        remarks.append(f"{spin.run}: a term with the square of the speed comes out negative")
    elif fan <= half:
        why = "the 95 % interval holds 0"
    else:
        why = "it moves with the viscous friction in one spin-down; b stands for both"
    whole = np.full((3, 3), np.nan)
    whole[:2, :2] = covariance
    return Analysis(
        "spin-down",
        (*parameters, unknown(_FAN, why)),
        whole,
        (_left(spin.run, "angular momentum", "N m s", fit),),
        tuple(remarks),
    )
