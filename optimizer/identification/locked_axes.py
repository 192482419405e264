"""Resistance and inductances from steps, pulses or sines of a voltage on a locked rotor.

At standstill each axis is

    (L + 2 C2 i + 3 C3 i^2) di/dt = u(t - tau) - R i - V0 i/sqrt(|i|^2 + w^2) - o

with the vector i of both axes in the inverter's error. The current is simulated from the voltages,
and all parameters are those that leave least of the measured one: noise of the current is no part
of any regressor then. Voltages are held from row to row and come n + f rows late. Start values are
those of a regression behind the filter F = 1/(1 + T_f p) with p F = (1 - F)/T_f, which takes no
slope of a noisy current:

    F u = R F i + L (i - F i)/T_f + V0 F s + f F (u_k - u_(k-1)) + b e^(-t/T_f).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import (
    SUPPORTED,
    Averaged,
    Groups,
    averaged,
    left_by,
    own_shares,
    separable,
)
from dqforge.optimizer.identification.parameters import (
    Analysis,
    RunResiduals,
    compared,
    judged,
    unknown,
    with_partners,
)

AXES = ("d", "q")
_LEAST_ROWS = 20
# Steps of time that differ by more are read at equal distances first.
_JITTER = 0.01
# An axis whose current moves by less than this share of the other's was not excited.
_QUIET = 0.05
# Current below which the inverter's error turns, as shares of the largest: first, least, most.
_TURNING = (0.02, 0.001, 0.3)
# Rows that a reference may come early in the log: calculation and the carrier's period.
_LATEST = 3
_ROUNDS = 4
# The filter's time constant in steps of time at least, and as a share of the log at most.
_LEAST_STEPS, _LARGEST_SHARE = 4.0, 0.1
# Steps of Runge and Kutta in each part of a row.
_STEPS = 2
_MOST_EVALUATIONS = 60
# Currents of so many times the largest are those of a simulation that runs away.
_FAR = 1e3
_RESISTANCE = ("resistance", "phase resistance", "Ohm")
_VOLTAGE = ("inverter_voltage", "voltage error of the inverter", "V")


@dataclass(frozen=True, slots=True)
class LockedAxes:
    """Rows of a run: time (s), currents (A) and voltages (V) of the axes that were logged, (N,).

    ``temperature`` is the mean one of the winding in degC, None where it is not known.
    """

    run: str
    time: FloatArray
    currents: Mapping[str, FloatArray]
    voltages: Mapping[str, FloatArray]
    temperature: float | None = None

    @property
    def step(self) -> float:
        """Time from row to row in s."""
        return float(np.median(np.diff(self.time)))

    @property
    def size(self) -> FloatArray:
        """Amplitude of the current in A, shape (N,)."""
        none = np.zeros_like(self.time)
        return np.hypot(*(self.currents.get(name, none) for name in AXES))

    def even(self) -> LockedAxes:
        """The same at equal distances of time: voltages held, currents by straight lines."""
        step = np.diff(self.time)
        if float(np.ptp(step)) <= _JITTER * float(np.median(step)):
            return self
        rows = 1 + round((self.time[-1] - self.time[0]) / float(np.median(step)))
        time = np.linspace(self.time[0], self.time[-1], rows)
        held = np.searchsorted(self.time, time, side="right") - 1
        return replace(
            self,
            time=time,
            currents={name: np.interp(time, self.time, i) for name, i in self.currents.items()},
            voltages={name: u[held] for name, u in self.voltages.items()},
        )


def locked_fault(rows: LockedAxes) -> str:
    """Why a run with a locked rotor says nothing, '' where it does."""
    if not rows.currents:
        return "no axis has current and voltage; log i_d with u_d, or i_q with u_q"
    if (np.diff(rows.time) <= 0.0).any():
        return "the times do not rise"
    if rows.time.size < _LEAST_ROWS:
        return f"{rows.time.size} rows; a curve of the current needs {_LEAST_ROWS}"
    for name, values in rows.currents.items():
        if np.ptp(values) == 0.0:
            return f"i_{name} stands still; log the current that the voltage drives"
        if np.ptp(rows.voltages[name]) == 0.0:
            return f"u_{name} stands still: no step, pulse or sine that a current answers"
    return ""


class _Filter:
    """F on rows a time ``step`` apart."""

    def __init__(self, time_constant: float, step: float) -> None:
        self.time_constant, ratio = time_constant, step / time_constant
        self.kept = math.exp(-ratio)
        self.late = 1.0 - (1.0 - self.kept) / ratio  # weight of the row itself

    def held(self, values: FloatArray) -> FloatArray:
        """F of what is held from row to row."""
        return np.asarray(lfilter([0.0, 1.0 - self.kept], [1.0, -self.kept], values))

    def straight(self, values: FloatArray) -> FloatArray:
        """F of what goes in straight lines from row to row, from 0."""
        early = 1.0 - self.kept - self.late
        whole: FloatArray = lfilter([self.late, early], [1.0, -self.kept], values)
        # The first row is no line from 0 before it.
        first = self.late * values[0] * self.kept ** np.arange(values.size)
        return np.asarray(whole - first)

    def slope(self, values: FloatArray) -> FloatArray:
        """Slope of F, p F."""
        return (values - self.straight(values)) / self.time_constant


def _late(values: FloatArray, rows: int) -> FloatArray:
    """Values that many rows later; before the first they are what they were."""
    return np.concatenate([np.full(rows, values[0]), values[: values.size - rows]])


# Start values.


def _regressed(
    rows: LockedAxes, time_constant: float, whole: int, *, reference: bool
) -> tuple[float, dict[str, float]]:
    """What the regression behind the filter leaves, and its terms."""
    f = _Filter(time_constant, rows.step)
    none = np.zeros_like(rows.time)
    smooth = np.hypot(rows.size, _TURNING[0] * float(rows.size.max()))
    columns: dict[str, list[FloatArray]] = {}
    values = []
    for place, (name, i) in enumerate(rows.currents.items()):
        u = _late(rows.voltages[name], whole)
        values.append(f.held(u))
        own = {
            "resistance": f.straight(i),
            f"inductance_{name}": f.slope(i),
            "inverter_voltage": f.straight(i / smooth),
            f"start_{name}": f.kept ** np.arange(i.size),
            "delay": f.held(u - _late(u, 1)),
        }
        for term, column in own.items():
            if reference or term != "inverter_voltage":
                columns.setdefault(term, [none] * len(rows.currents))[place] = np.asarray(column)
    whole_rows = np.column_stack([np.concatenate(parts) for parts in columns.values()])
    aim = np.concatenate(values)
    left = left_by(whole_rows, aim)
    found = np.linalg.lstsq(whole_rows, aim, rcond=None)[0]
    return float(left @ left), dict(zip(columns, map(float, found), strict=True))


def _started(rows: LockedAxes, *, reference: bool) -> tuple[int, dict[str, float]]:
    """Rows by which the voltage is late, and terms by the filter that is as slow as the winding."""
    slowest = max(_LARGEST_SHARE * float(np.ptp(rows.time)), _LEAST_STEPS * rows.step)
    time_constant = slowest
    for _ in range(_ROUNDS):
        found = [
            _regressed(rows, time_constant, whole, reference=reference)
            for whole in range(_LATEST + 1)
        ]
        whole = min(range(len(found)), key=lambda place: found[place][0])
        terms = found[whole][1]
        own = float(np.mean([terms[f"inductance_{name}"] for name in rows.currents]))
        ratio = own / terms["resistance"] if terms["resistance"] else 0.0
        if not ratio > 0.0:
            break
        time_constant = min(max(ratio, _LEAST_STEPS * rows.step), slowest)
    return whole, terms


# The simulated current.


def _terms(rows: LockedAxes, *, reference: bool) -> list[str]:
    """All parameters: those that every model has, and the others."""
    each = [f"{term}_{name}" for name in rows.currents for term in ("inductance", "start")]
    more = [f"{term}_{name}" for name in rows.currents for term in ("offset", "square", "cube")]
    error = ["inverter_voltage", "turning"] if reference else []
    return ["resistance", *each, *error, "delay", *more]


def _simulation(
    rows: LockedAxes, terms: list[str], whole: int
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """From parameters to the currents of all axes, shape (N,), and their derivatives, (N, K)."""
    import casadi as ca

    names, count = list(rows.currents), len(terms)
    p = ca.SX.sym("p", count)
    value: dict[str, Any] = {term: p[place] for place, term in enumerate(terms)}
    i = ca.SX.sym("i", len(names))
    before, now = ca.SX.sym("before", len(names)), ca.SX.sym("now", len(names))

    def slope(current: Any, voltage: Any) -> Any:
        size = ca.sqrt(ca.sumsqr(current) + value.get("turning", 1.0) ** 2)
        found = []
        for k, name in enumerate(names):
            x = current[k]
            own = value[f"inductance_{name}"]
            own += 2.0 * value[f"square_{name}"] * x + 3.0 * value[f"cube_{name}"] * x**2
            drop = value["resistance"] * x + value.get("inverter_voltage", 0.0) * x / size
            found.append((voltage[k] - drop - value[f"offset_{name}"]) / own)
        return ca.vertcat(*found)

    after: Any = i
    for voltage, share in ((before, value["delay"]), (now, 1.0 - value["delay"])):
        h = rows.step * share / _STEPS
        for _ in range(_STEPS):
            k1 = slope(after, voltage)
            k2 = slope(after + 0.5 * h * k1, voltage)
            k3 = slope(after + 0.5 * h * k2, voltage)
            k4 = slope(after + h * k3, voltage)
            after = after + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    # The derivatives go along with the current.
    turned = ca.SX.sym("turned", len(names), count)
    onward = ca.jacobian(after, i) @ turned + ca.jacobian(after, p)
    held, fed = ca.vertcat(i, ca.vec(turned)), ca.vertcat(before, now)
    row = ca.Function("row", [held, fed, p], [ca.vertcat(after, ca.vec(onward))], {"cse": True})
    every = row.mapaccum(rows.time.size - 1)
    driven = np.array([_late(rows.voltages[name], whole) for name in names])
    earlier = np.array([_late(u, 1) for u in driven])
    inputs = np.vstack([earlier[:, :-1], driven[:, :-1]])
    starts = [terms.index(f"start_{name}") for name in names]
    begin = np.zeros((len(names), count))
    begin[range(len(names)), starts] = 1.0

    last: dict[bytes, tuple[FloatArray, FloatArray]] = {}
    far = _FAR * float(rows.size.max())

    def run(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = at.tobytes()
        if key in last:  # asked for the currents, then for their derivatives
            return last[key]
        first = np.concatenate([at[starts], begin.ravel(order="F")])
        rest = np.array(every(first, inputs, np.repeat(at[:, None], inputs.shape[1], axis=1)))
        states = np.column_stack([first, rest])
        turns = states[len(names) :].reshape(count, len(names), -1).transpose(1, 2, 0)
        currents = states[: len(names)].ravel()
        if not np.isfinite(currents).all() or np.max(np.abs(currents)) > far:
            currents = np.full(currents.size, far)  # a step too far, which is taken back
        last.clear()
        last[key] = currents, turns.reshape(-1, count)
        return last[key]

    return run


@dataclass(frozen=True, slots=True)
class _Fit:
    """What leaves least of the currents: terms, their values, derivatives of the currents, shape
    (N, K), what is left (N,), each row's axis, the rows by which the voltage is late, the time of a
    row in s and whether the voltages are references.
    """

    terms: list[str]
    at: FloatArray
    rows: FloatArray
    left: FloatArray
    series: Groups
    whole: int
    step: float
    reference: bool

    @property
    def inductances(self) -> list[str]:
        """Terms of the inductances, in the order of the axes."""
        return [term for term in self.terms if term.startswith("inductance")]

    def kept(self) -> list[float]:
        """Share of each axis's current that is there after a row without voltage."""
        ratio = self.at[self.terms.index("resistance")] * self.step
        return [math.exp(-ratio / self.at[self.terms.index(one)]) for one in self.inductances]


def _fitted(rows: LockedAxes, *, reference: bool) -> _Fit:
    whole, start = _started(rows, reference=reference)
    terms = _terms(rows, reference=reference)
    largest = float(rows.size.max())
    measured = np.concatenate(list(rows.currents.values()))
    series = np.repeat(np.arange(len(rows.currents)), rows.time.size)
    for _ in range(_LATEST + 1):
        first, low, high = _range(rows, terms, start, largest)
        run = _simulation(rows, terms, whole)
        found = least_squares(
            lambda values, run=run: run(values)[0] - measured,
            first,
            lambda values, run=run: run(values)[1],
            bounds=(low, high),
            x_scale=np.maximum(np.abs(first), 1e-3 * (high - low)),
            max_nfev=_MOST_EVALUATIONS,
        )
        share = float(found.x[terms.index("delay")])
        if share > 1.0 - _EDGE and whole < _LATEST:
            whole += 1
        elif share < _EDGE and whole > 0 and start["delay"] < 0.0:
            whole -= 1
        else:
            break
        start = start | {"delay": 1.0 - share}
    currents, turns = run(found.x)
    if not np.isfinite(turns).all() or float(np.ptp(currents)) == 0.0:
        raise FloatingPointError
    left = measured - currents
    return _Fit(terms, found.x, turns, left, series, whole, rows.step, reference)


_EDGE = 1e-3


def _range(
    rows: LockedAxes, terms: list[str], start: Mapping[str, float], largest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """First, least and largest value of each term."""
    drop = max(float(np.max(np.abs(u))) for u in rows.voltages.values())
    resistance = max(start["resistance"], 1e-3 * drop / largest)
    first, low, high = [], [], []
    for term in terms:
        kind, _, name = term.rpartition("_")
        inductance = max(start.get(f"inductance_{name}", 0.0), resistance * rows.step)
        bend = inductance / largest ** {"square": 1, "cube": 2}.get(kind, 1)
        begin, least, most = {
            "resistance": (resistance, 0.0, 100.0 * resistance),
            f"inductance_{name}": (inductance, 1e-2 * inductance, 1e2 * inductance),
            f"start_{name}": (float(rows.currents.get(name, rows.size)[0]), -largest, largest),
            "inverter_voltage": (max(start.get(term, 0.0), 0.0), -drop, drop),
            "turning": tuple(share * largest for share in _TURNING),
            "delay": (min(max(start["delay"], 0.1), 0.9), 0.0, 1.0),
            f"offset_{name}": (0.0, -drop, drop),
            f"square_{name}": (0.0, -0.45 * bend, 0.45 * bend),
            f"cube_{name}": (0.0, -0.3 * bend, 0.3 * bend),
        }[term]
        first.append(begin)
        low.append(least)
        high.append(most)
    bounds = np.array(low), np.array(high)
    return np.clip(np.array(first), *bounds), *bounds


def analyse_locked(
    rows: LockedAxes, known: Mapping[str, tuple[float, str]], *, reference: bool
) -> Analysis:
    """Resistance, inductances at no current and, of references, the inverter's error, of rows that
    `locked_fault` has nothing against.

    Args:
        rows: The rows.
        known: Other values in SI units by key, with where they come from.
        reference: Whether the voltages are what the controller asked for.
    """
    rows = rows.even()
    remarks: list[str] = []
    moved = {name: float(np.ptp(values)) for name, values in rows.currents.items()}
    for name in [name for name in moved if moved[name] < _QUIET * max(moved.values())]:
        remarks.append(f"{rows.run}: i_{name} hardly moves; it is left out")
        rows = replace(
            rows, currents={key: one for key, one in rows.currents.items() if key != name}
        )
    found = _fitted(rows, reference=reference)
    terms, fit = _averaged(found)
    named = [
        _RESISTANCE,
        *((f"inductance_{n}", f"{n}-axis inductance", "H") for n in rows.currents),
    ]
    named += [_VOLTAGE] if reference else []
    if rows.temperature is not None:
        named[0] = (_RESISTANCE[0], f"{_RESISTANCE[1]} at {rows.temperature:.0f} degC", "Ohm")
    reasons = _reasons(found)
    places = [terms.index(key) for key, _, _ in named]
    parameters = [
        judged(
            one,
            float(fit.coefficients[place]),
            math.sqrt(fit.covariance[place, place]),
            fit.best.freedom,
            runs=(rows.run,),
            reason=reasons.get(one[0], ""),
            may_vanish=one is _VOLTAGE,
        )
        for one, place in zip(named, places, strict=True)
    ]
    covariance = fit.covariance[np.ix_(places, places)]
    parameters = with_partners(parameters, covariance)
    absent = [
        unknown(
            (f"inductance_{name}", f"{name}-axis inductance", "H"), f"no voltage on the {name} axis"
        )
        for name in AXES
        if name not in rows.currents
    ]
    whole = np.full((len(parameters) + len(absent),) * 2, np.nan)
    whole[: len(parameters), : len(parameters)] = covariance
    contradictions: list[str] = []
    for one in parameters:
        if one.key in known and one.status == "identified":
            text, against = compared(one, *known[one.key])
            (contradictions if against else remarks).append(f"{rows.run}: {text}")
    remarks += _told(rows, found.whole, terms, fit)
    left = tuple(
        RunResiduals(
            rows.run,
            f"i_{name}",
            "A",
            float(np.sqrt(np.mean(part**2))),
            part.size,
            fit.best.effective * part.size / found.series.size,
            part,
        )
        for place, name in enumerate(rows.currents)
        for part in (found.left[found.series == place],)
    )
    taken = tuple(
        term
        for place, term in enumerate(terms)
        if fit.included[place] > SUPPORTED and "start" not in term
    )
    return Analysis(
        "locked-voltage",
        (*parameters, *absent),
        whole,
        left,
        tuple(remarks),
        tuple(contradictions),
        tuple(_WORDS.get(term, term.replace("_", " ")) for term in taken),
    )


_WORDS = {
    "delay": "delay of the voltage",
    "inverter_voltage": "error of the inverter",
    "turning": "its rounding around zero current",
} | {
    f"{term}_{name}": f"{word} of {what}_{name}"
    for name in AXES
    for term, word, what in (
        ("square", "inductance that changes", "i"),
        ("cube", "inductance that changes with the square", "i"),
        ("offset", "offset", "u"),
    )
}


# Share of a column that no other term makes, from which it is apart from them: of steps the delay
# has 0.4, of one sine 0.002 to 0.007, and what an inverter adds to a sine is no second frequency.
_LEAST_APART = {"delay": 1e-2, "inverter_voltage": 1e-3}


def _averaged(found: _Fit) -> tuple[list[str], Averaged]:
    """Terms with those first that every model has, and their average over all models."""
    apart = dict(zip(found.terms, separable(found.rows), strict=True))
    always = ("resistance", "inductance", "start", "inverter", "turning")
    base = [
        term
        for term in found.terms
        if term.startswith(always) and (apart[term] or not term.startswith("turning"))
    ]
    terms = base + [term for term in found.terms if not term.startswith(always)]
    places = [found.terms.index(term) for term in terms]
    rows = found.rows[:, places]
    aim = found.left + rows @ found.at[places]
    white, noise = _whitened(np.column_stack([rows, aim]), found)
    fit = averaged(white[:, :-1], range(len(base)), white[:, -1], found.series)
    within = white[:, fit.places]
    coefficients = fit.coefficients.copy()
    if not found.reference:
        taken = _of_noisy_voltages(found, noise, fit.best.rms**2)[places][list(fit.places)]
        scale = np.linalg.norm(within, axis=0)
        curvature = (within / scale).T @ (within / scale)
        coefficients[list(fit.places)] += np.linalg.solve(curvature, taken / scale) / scale
    covariance = _at_least_white(fit, within)
    return terms, replace(fit, coefficients=coefficients, covariance=covariance)


def _at_least_white(fit: Averaged, rows: FloatArray) -> FloatArray:
    """Covariance whose errors are no smaller than those of white rows: few levels of a current make
    the sandwich too small.
    """
    scale = np.linalg.norm(rows, axis=0)
    plain = np.diag(np.linalg.inv((rows / scale).T @ (rows / scale))) * (fit.best.rms / scale) ** 2
    wider = np.ones(fit.covariance.shape[0])
    own = np.diag(fit.covariance)[list(fit.places)]
    wider[list(fit.places)] = np.sqrt(np.maximum(1.0, plain / np.maximum(own, 1e-300)))
    return fit.covariance * np.outer(wider, wider)


# Noise of logged voltages moves the simulated current, and the winding keeps it: what is left is
# white noise of the current beside one that falls with a = e^(-R t_s/L) per row. Squares of the
# noise of the voltage over R times that of the current:
_NOISES = (0.0, *np.geomspace(1e-4, 1e4, 33))


def _parted(values: NDArray[Any], series: Groups) -> list[NDArray[Any]]:
    return [values[series == label] for label in np.unique(series)]


def _white(values: FloatArray, kept: float, noise: float) -> tuple[FloatArray, float]:
    """What the steady Kalman filter of both noises could not predict, in units of the noise of the
    current, and its standard deviation in them. ``kept`` is a, ``noise`` one of `_NOISES`.
    """
    part = (1.0 - kept) ** 2 * noise
    less = 0.5 * (1.0 - kept * kept - part)
    before = math.sqrt(less * less + part) - less  # variance before a row is read
    spread = math.sqrt(before + 1.0)
    pole = kept / (before + 1.0)
    return np.asarray(lfilter([1.0, -kept], [1.0, -pole], values, axis=0)) / spread, spread


def _whitened(rows: FloatArray, found: _Fit) -> tuple[FloatArray, float]:
    """Rows whose last column is left white by the others, and the noise of the voltage: the
    likeliest one where the coefficients are integrated out (restricted maximum likelihood).
    """
    best = (math.inf, rows, 0.0)
    for noise in _NOISES:
        pairs = zip(_parted(rows, found.series), found.kept(), strict=True)
        parts = [_white(part, kept, noise) for part, kept in pairs]
        white = np.concatenate([part for part, _ in parts])
        factor = np.log(np.abs(np.diag(np.linalg.qr(white, mode="r"))))
        free = white.shape[0] - white.shape[1] + 1
        likely = free * factor[-1] + np.sum(factor[:-1])
        likely += sum(part.shape[0] * math.log(spread) for part, spread in parts)
        if likely < best[0]:
            best = float(likely), white, noise
    return best[1:]


def _of_noisy_voltages(found: _Fit, noise: float, square: float) -> FloatArray:
    """What noise of the voltages takes from the scores of all terms, shape (K,): it is in the
    simulated current and in its derivatives. ``square`` is that of the noise of the current.
    """
    taken = np.zeros(len(found.terms))
    count = found.left.size // len(found.inductances)

    def answer(own: FloatArray, kept: float) -> FloatArray:
        """White current after a volt in one row, of R, L and delay ``own``."""
        a = math.exp(-own[0] * found.step / own[1])
        pulse = np.zeros(count)
        pulse[1:3] = 1.0 - own[2], own[2]
        return _white(np.asarray(lfilter([(1.0 - a) / own[0]], [1.0, -a], pulse)), kept, noise)[0]

    for term, kept in zip(found.inductances, found.kept(), strict=True):
        at = [found.terms.index(name) for name in ("resistance", term, "delay")]
        own = found.at[at]
        step = _SMALL * np.array([own[0], own[1], 1.0])
        white = answer(own, kept)
        slopes = [answer(own + one, kept) - white for one in np.diag(step)]
        taken[at] += count * noise * own[0] ** 2 * square * (np.array(slopes) @ white) / step
    return taken


_SMALL = 1e-5


def _reasons(found: _Fit) -> dict[str, str]:
    """What the rows cannot hold, whatever the errors say, by term."""
    plain = [term for term in found.terms if not term.startswith(("square", "cube", "turning"))]
    own = own_shares(found.rows[:, [found.terms.index(term) for term in plain]])
    apart = {
        term: share > _LEAST_APART.get(term, 0.0) for term, share in zip(plain, own, strict=True)
    }
    reasons: dict[str, str] = {}
    if not apart["delay"]:
        why = "one frequency: a delay of the voltage looks like resistance and inductance"
        reasons |= {term: f"{why}; add steps or another one" for term in plain if term[0] in "ri"}
    if not apart.get("inverter_voltage", True):
        why = "one amplitude of the current: resistance and inverter voltage move together"
        reasons |= {"resistance": why, "inverter_voltage": why}
    return reasons


def _told(rows: LockedAxes, whole: int, terms: list[str], fit: Averaged) -> list[str]:
    """Delay, and how the inductances change with the current."""
    late = whole * rows.step
    if fit.included[terms.index("delay")] > SUPPORTED:
        late += rows.step * float(fit.coefficients[terms.index("delay")])
    told = [f"{rows.run}: the voltage comes {1e6 * late:.3g} us after its row"] if late else []
    for name, current in rows.currents.items():
        square, cube = (terms.index(f"{term}_{name}") for term in ("square", "cube"))
        if max(fit.included[square], fit.included[cube]) <= SUPPORTED:
            continue
        most = float(current[np.argmax(np.abs(current))])
        base = float(fit.coefficients[terms.index(f"inductance_{name}")])
        bend = 2.0 * fit.coefficients[square] * most + 3.0 * fit.coefficients[cube] * most**2
        told.append(
            f"{rows.run}: the {name}-axis inductance of small changes is {1e3 * base:.4g} mH "
            f"without current and {1e3 * (base + bend):.4g} mH at {most:.3g} A; the design takes "
            "the first"
        )
    return told
