"""Resistance, flux linkages and the voltage error of the inverter from rows of currents, voltages
and speed.

The voltage of both axes is linear in what is sought:

    u_d = R i_d - w (psi_q0 + L_q i_q) + V0 s_d + offset
    u_q = R i_q + w (psi_pm + L_d i_d + c |i_q|) + V0 s_q + offset

with s = i/|i| smoothed about zero, and R that may change with the temperature. psi_q0 is that of
an encoder turned by -psi_q0/psi_pm, by which the rows are turned back. Which of the terms the rows
support is decided by BIC with the effective number of rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import (
    SUPPORTED,
    Groups,
    Regression,
    averaged,
    correlation_time,
    left_by,
    own_shares,
    regress,
    separable,
)
from dqforge.optimizer.identification.log_checks import step_of
from dqforge.optimizer.identification.parameters import (
    Analysis,
    OverTemperature,
    Parameter,
    RunResiduals,
    compared,
    judged,
    student_95,
    suspected,
    unknown,
    with_partners,
)

# Copper at 20 degC, per kelvin.
COPPER = 0.00393
# Copper's own coefficient by its purity and the temperature that it is stated at, 20 or 25 degC.
_PURITY = 0.03
# A temperature coefficient needs a range over which copper changes by 6 %.
_LEAST_RANGE_K = 15.0
# Below this share of the largest current the voltage of the dead time is not yet whole.
_SMOOTH = 0.02
# Currents below this share of the largest are none.
_NONE = 0.05
# Residuals below this share of a voltage are rounding and no noise.
_LEAST_NOISE = 1e-9
# Three rows for each of the usual terms.
_LEAST_ROWS = 18
# Of one quadrant where fewer rows than this share are of another.
_FEW = 0.05

TERMS: Mapping[str, tuple[str, str]] = {
    "resistance": ("phase resistance", "Ohm"),
    "resistance_slope": ("change of the resistance with temperature", "Ohm/K"),
    "magnet_flux": ("magnet flux linkage", "Wb"),
    "inductance_d": ("d-axis inductance", "H"),
    "cross_saturation": ("change of psi_d with |i_q|", "Wb/A"),
    "inductance_q": ("q-axis inductance", "H"),
    "inverter_voltage": ("voltage error of the inverter along the current", "V"),
    "offset_d": ("offset of u_d", "V"),
    "offset_q": ("offset of u_q", "V"),
    "encoder_angle": ("error of the encoder's angle", "rad"),
}
_BASE = ("resistance", "magnet_flux")
_MAY_VANISH = ("cross_saturation", "inverter_voltage", "offset_d", "offset_q", "encoder_angle")


@dataclass(frozen=True, slots=True)
class SteadyRows:
    """Rows of runs in SI units, each array of shape (N,): currents, voltages, electrical speed in
    rad/s, temperature of the winding in degC; None for what was not logged. ``series`` is the place
    of each row's run in ``runs``, ``steps`` those of columns whose rows are means (SI units, by
    name); None where they are to be found in the rows. ``middle`` is the temperature for which
    the resistance is given, in degC; None for the mean of the rows.
    """

    runs: tuple[str, ...]
    series: Groups
    omega_e: FloatArray
    i_q: FloatArray
    u_q: FloatArray
    i_d: FloatArray | None = None
    u_d: FloatArray | None = None
    temperature: FloatArray | None = None
    steps: Mapping[str, float] | None = None
    middle: float | None = None

    @property
    def current(self) -> FloatArray:
        """Amplitude of the current in A, shape (N,)."""
        return np.hypot(self.i_q, 0.0 if self.i_d is None else self.i_d)

    def some(self, kept: NDArray[np.bool_]) -> SteadyRows:
        """Those rows for which ``kept``, shape (N,), is true."""
        i_d, u_d, temperature = (
            None if each is None else each[kept] for each in (self.i_d, self.u_d, self.temperature)
        )
        return replace(
            self,
            series=self.series[kept],
            omega_e=self.omega_e[kept],
            i_q=self.i_q[kept],
            u_q=self.u_q[kept],
            i_d=i_d,
            u_d=u_d,
            temperature=temperature,
        )


@dataclass(frozen=True, slots=True)
class _Model:
    """Columns by term over the rows of u_q, then those of u_d where it was logged."""

    columns: Mapping[str, FloatArray]
    values: FloatArray
    series: Groups
    axis: Groups
    mean_temperature: float | None
    scale: FloatArray

    def weighted(self) -> _Model:
        """The same with each axis in units of what all terms together leave of it."""
        whole = np.column_stack(list(self.columns.values()))
        left = left_by(whole[:, separable(whole)], self.values)
        scale = np.ones(self.values.size)
        for axis in np.unique(self.axis):
            kept = self.axis == axis
            least = _LEAST_NOISE * float(np.sqrt(np.mean(self.values[kept] ** 2)))
            scale[kept] = max(float(np.sqrt(np.mean(left[kept] ** 2))), least, 1e-12)
        whole /= scale[:, None]
        columns = dict(zip(self.columns, whole.T, strict=True))
        values = self.values / scale
        return _Model(columns, values, self.series, self.axis, self.mean_temperature, scale)


def voltage_columns(rows: SteadyRows) -> dict[str, FloatArray]:
    """Columns by term over the rows of u_q, then those of u_d where it was logged."""
    i_d = np.zeros_like(rows.i_q) if rows.i_d is None else rows.i_d
    whole = np.hypot(rows.current, _SMOOTH * max(float(rows.current.max()), 1e-12))
    zero, one = np.zeros_like(i_d), np.ones_like(i_d)
    by_term: dict[str, tuple[FloatArray, FloatArray]] = {
        "resistance": (rows.i_q, i_d),
        "magnet_flux": (rows.omega_e, zero),
        "cross_saturation": (rows.omega_e * np.abs(rows.i_q), zero),
        "inverter_voltage": (rows.i_q / whole, i_d / whole),
        "offset_q": (one, zero),
    }
    if rows.i_d is not None:
        by_term["inductance_d"] = (rows.omega_e * i_d, zero)
    if rows.u_d is not None:
        by_term["inductance_q"] = (zero, -rows.omega_e * rows.i_q)
        by_term["offset_d"] = (zero, one)
    if shows_angle(rows):
        by_term["encoder_angle"] = (zero, -rows.omega_e)
    if rows.temperature is not None:
        warmer = rows.temperature - _middle(rows)
        by_term["resistance_slope"] = (warmer * rows.i_q, warmer * i_d)
    axes = (0, 1) if rows.u_d is not None else (0,)
    return {term: np.concatenate([pair[axis] for axis in axes]) for term, pair in by_term.items()}


def shows_angle(rows: SteadyRows) -> bool:
    """Whether rows show psi_q without current as an angle of the encoder: a current of one sign
    that saturates looks the same, and in one direction iron loss and a delay of the voltage do.
    """
    if rows.i_d is None or rows.u_d is None:
        return False
    for values in (rows.i_q, rows.omega_e):
        least = _NONE * float(np.max(np.abs(values)))
        sides = (values > least).sum(), (values < -least).sum()
        if min(sides) < _FEW * max(sum(sides), 1):
            return False
    return True


# Standard deviations from which on rows are turned back, least angle (rad), and rows that tell it.
_TURNED, _LEAST_TURN, _ENOUGH = 3.0, 2e-3, 20_000


def _upright(rows: SteadyRows, *, reference: bool) -> tuple[SteadyRows, float]:
    """Rows in the frame of the rotor, and the angle in rad by which they were turned to it."""
    if not shows_angle(rows):
        return rows, 0.0
    kept: BoolArray = np.zeros(rows.u_q.size, dtype=np.bool_)
    kept[:: -(-kept.size // _ENOUGH)] = True
    part, angle = rows.some(kept), 0.0
    for _ in range(4):
        if not shows_angle(part):
            return rows, 0.0
        model = _model(part).weighted()
        terms = [*_base(model, reference=reference), "inductance_q", "inductance_d"]
        apart = separable(np.column_stack([model.columns[term] for term in terms]))
        terms = [term for term, held in zip(terms, apart, strict=True) if held]
        if "encoder_angle" not in terms or "magnet_flux" not in terms:
            return rows, 0.0
        fit = _regression(model, terms)
        at, of_flux = terms.index("encoder_angle"), terms.index("magnet_flux")
        flux = float(fit.coefficients[of_flux])
        turn, sigma = -float(fit.coefficients[at]) / flux, math.sqrt(fit.covariance[at, at]) / flux
        if abs(turn) < max(_TURNED * abs(sigma), _LEAST_TURN):
            break
        angle += turn
        part = _turned(rows.some(kept), angle)
    return (_turned(rows, angle) if angle else rows), angle


def _turned(rows: SteadyRows, angle: float) -> SteadyRows:
    """Currents and voltages in a frame that is turned by an angle in rad."""
    assert rows.i_d is not None
    assert rows.u_d is not None
    c, s = math.cos(angle), math.sin(angle)
    steps = rows.steps
    if steps is None:
        columns = {"i_d": rows.i_d, "i_q": rows.i_q, "u_d": rows.u_d, "u_q": rows.u_q}
        columns["omega_e"] = rows.omega_e
        steps = {name: step_of(values) for name, values in columns.items()}
    return replace(
        rows,
        i_d=c * rows.i_d - s * rows.i_q,
        i_q=c * rows.i_q + s * rows.i_d,
        u_d=c * rows.u_d - s * rows.u_q,
        u_q=c * rows.u_q + s * rows.u_d,
        steps=steps,
    )


def _middle(rows: SteadyRows) -> float:
    """Temperature in degC for which the resistance is given."""
    if rows.middle is not None or rows.temperature is None:
        return rows.middle or 0.0
    return float(rows.temperature.mean())


def _model(rows: SteadyRows) -> _Model:
    columns = voltage_columns(rows)
    axes = (0, 1) if rows.u_d is not None else (0,)
    mean = None if rows.temperature is None else _middle(rows)
    values = np.concatenate([each for each in (rows.u_q, rows.u_d) if each is not None])
    axis = np.repeat(np.array(axes, dtype=np.intp), rows.u_q.size)
    series = np.tile(rows.series, len(axes)) + axis * len(rows.runs)
    return _Model(columns, values, series, axis, mean, np.ones(values.size))


@dataclass(frozen=True, slots=True)
class _Found:
    """Coefficients of the terms with their covariance, the share of each column that is not in the
    others, effective degrees of freedom, and the residuals of the best model.
    """

    coefficients: FloatArray
    covariance: FloatArray
    own: FloatArray
    freedom: float
    residuals: FloatArray


def _base(model: _Model, *, reference: bool) -> list[str]:
    """Terms that are there whatever the rows say: an inverter that is told a voltage always makes
    an error along the current, and where it is left out the resistance takes it up.
    """
    terms = list(_BASE)
    with_error = [*terms, "inverter_voltage"]
    columns = np.column_stack([model.columns[term] for term in with_error])
    if reference and bool(separable(columns).all()):
        terms = with_error
    return [*terms, "encoder_angle"] if "encoder_angle" in model.columns else terms


def _regression(model: _Model, terms: Sequence[str]) -> Regression:
    rows = np.column_stack([model.columns[term] for term in terms])
    return regress(rows, model.values, model.series)


def rows_fault(rows: SteadyRows) -> str:
    """Why rows say nothing, '' where they do."""
    if rows.u_q.size < _LEAST_ROWS:
        return f"{rows.u_q.size} rows for up to {len(TERMS)} terms; it needs {_LEAST_ROWS}"
    if float(rows.current.max()) <= 0.0:
        return "no current flows in any row, which gives no resistance"
    if float(np.ptp(rows.omega_e)) == 0.0 and float(np.max(np.abs(rows.omega_e))) == 0.0:
        return "the shaft stands still in all rows, which gives no flux linkage"
    kept = _BASE
    found = np.column_stack([_model(rows).columns[term] for term in kept])
    if not separable(found).all():
        return "current and speed rise together in all rows; vary one without the other"
    return ""


def analyse_rows(
    rows: SteadyRows,
    known: Mapping[str, tuple[float, str]],
    *,
    reference: bool,
    inductance_d: tuple[float, float, str] | None = None,
) -> Analysis:
    """Parameters of rows that `rows_fault` has nothing against.

    Args:
        rows: The rows.
        known: Other values in SI units by key, with where they come from.
        reference: Whether the voltages are what the controller asked for, which contain the error
            of the inverter.
        inductance_d: In H with its standard deviation and where it comes from, for rows whose d
            current does not show it.
    """
    rows, angle = _upright(rows, reference=reference)
    model = _model(rows).weighted()
    open_terms = [term for term in model.columns if reference or term != "inverter_voltage"]
    base = _base(model, reference=reference)
    ordered = [*base, *(term for term in open_terms if term not in base)]
    columns = np.column_stack([model.columns[term] for term in ordered])
    # Views: a long ride has no room for every column twice.
    model = replace(model, columns=dict(zip(ordered, columns.T, strict=True)))
    mean = averaged(columns, range(len(base)), model.values, model.series)
    # A base may hold what only together with a term that was not taken can be told.
    places = [
        place
        for place in range(len(ordered))
        if place < len(base) or mean.included[place] > SUPPORTED
    ]
    terms = [ordered[place] for place in places]
    floor, coarse = _rounding(rows, model, terms, mean.coefficients[places], mean.best.residuals)
    covariance = mean.covariance[np.ix_(places, places)]
    fit = _Found(
        mean.coefficients[places],
        _at_least(covariance, floor),
        own_shares(columns[:, places]),
        mean.best.freedom,
        mean.best.residuals,
    )
    fit, of_current = _less_d_current(rows, terms, fit, inductance_d)
    fit = _as_angle(terms, fit, angle)
    reasons = _reasons(rows, terms, fit, _quadrants(rows))
    parameters = [
        _parameter(rows, model, term, place, fit, reasons.get(term, ""))
        for place, term in enumerate(terms)
    ]
    covariance = fit.covariance
    parameters = with_partners(parameters, covariance)
    parameters, covariance = _with_coefficient(rows, model, terms, fit, parameters, covariance)
    absent = [_absent(term, rows, open_terms) for term in TERMS if term not in terms]
    whole = len(parameters) + len(absent)
    padded = np.full((whole, whole), np.nan)
    padded[: len(parameters), : len(parameters)] = covariance
    remarks, contradictions = _told(rows, model, fit, parameters, known)
    if abs(angle) > _TOLD_ANGLE:
        remarks.append(
            f"{', '.join(rows.runs)}: the encoder is {math.degrees(angle):.2g} deg off; currents "
            "and voltages are turned back to the rotor; correct the encoder's offset by that"
        )
    remarks += [*of_current, *coarse, *_drift(rows, model, terms)]
    return Analysis(
        "constant-speed",
        (*parameters, *absent),
        padded,
        tuple(_residuals(rows, model, fit)),
        tuple(remarks),
        tuple(contradictions),
        tuple(TERMS[term][0] for term in terms),
        _over_temperature(rows, model, terms, fit),
    )


# Half of the 95 % interval of L_d, over L_q, where nothing tells the saliency.
_SALIENCY = 0.5
# Standard deviations in half of a 95 % interval of the normal distribution.
HALF_95 = 1.96


def _less_d_current(
    rows: SteadyRows,
    terms: Sequence[str],
    fit: _Found,
    inductance_d: tuple[float, float, str] | None,
) -> tuple[_Found, list[str]]:
    """What is found without what a d current that hardly changes makes of the flux linkage: it is
    in the magnets' where no term of its own is supported. With L_d from elsewhere, or L_q of these
    rows in its place.
    """
    if "inductance_d" in terms or rows.i_d is None:
        return fit, []
    square = rows.omega_e @ rows.omega_e
    current = float(rows.omega_e @ (rows.omega_e * rows.i_d) / square)
    if inductance_d is None and "inductance_q" in terms:
        own = abs(float(fit.coefficients[terms.index("inductance_q")]))
        inductance_d = own, _SALIENCY * own / HALF_95, "L_q, which stands for it"
    names, at = ", ".join(rows.runs), terms.index("magnet_flux")
    if inductance_d is None:
        if abs(current) < _TOLD_CURRENT * float(rows.current.max()):
            return fit, []
        told = (
            f"{names}: i_d is {current:.2g} A on the average, and psi_pm holds L_d times that; "
            "write inductance_d under machine"
        )
        return fit, [told]
    value, sigma, origin = inductance_d
    moved, wide = value * current, sigma * current
    if abs(moved) < _TOLD_SHARE * math.sqrt(fit.covariance[at, at]):
        return fit, []
    coefficients, covariance = fit.coefficients.copy(), fit.covariance.copy()
    coefficients[at] -= moved
    covariance[at, at] += wide**2
    told = (
        f"{names}: i_d is {current:.2g} A on the average; L_d i_d, {1e3 * moved:.2g} mWb by "
        f"{origin}, is not part of psi_pm"
    )
    return replace(fit, coefficients=coefficients, covariance=covariance), [told]


# A mean d current over the largest current, and its flux linkage over the standard deviation, from
# which on they are told.
_TOLD_CURRENT, _TOLD_SHARE = 0.01, 0.1


# Numbers with steps: what falls below one is not in the rows, however many there are.

_STEP_UNITS = {"i_d": "A", "i_q": "A", "u_d": "V", "u_q": "V", "omega_e": "rad/s electrical"}


_MOST_TOLD = 20_000


def _rounding(
    rows: SteadyRows,
    model: _Model,
    terms: Sequence[str],
    coefficients: FloatArray,
    residuals: FloatArray,
) -> tuple[FloatArray, list[str]]:
    """Covariance, shape (K, K), that rounding to steps alone leaves, and sentences on the steps
    that are larger than the noise.

    A rounded number errs by a twelfth of the squared step, and errs the same way until it changes:
    only its changes count as rows.
    """
    columns: dict[str, FloatArray | None] = {
        "i_d": rows.i_d, "i_q": rows.i_q, "u_d": rows.u_d, "u_q": rows.u_q, "omega_e": rows.omega_e
    }  # fmt: skip
    found, told = np.zeros((len(terms), len(terms))), list[str]()
    steps = {
        name: step
        for name, values in columns.items()
        if values is not None
        and (step := step_of(values) if rows.steps is None else rows.steps.get(name, 0.0)) > 0.0
    }
    if not steps:
        return found, told
    # Some rows tell the same of large logs as all.
    kept: BoolArray = np.zeros(rows.u_q.size, dtype=np.bool_)
    kept[:: -(-kept.size // _MOST_TOLD)] = True
    both = np.tile(kept, model.values.size // kept.size)
    some, axis, scale, left = rows.some(kept), model.axis[both], model.scale[both], residuals[both]
    weighted = np.column_stack([model.columns[term][both] for term in terms])
    bread = np.linalg.pinv(weighted.T @ weighted)
    base = voltage_columns(some)
    for name, step in steps.items():
        values = columns[name]
        if values is None:
            continue
        if name.startswith("u"):
            moved = np.where(axis == (name == "u_d"), step, 0.0) / scale
        else:
            beside = voltage_columns(
                replace(
                    some,
                    i_d=some.i_d if some.i_d is None else some.i_d + step * (name == "i_d"),
                    i_q=some.i_q + step * (name == "i_q"),
                    omega_e=some.omega_e + step * (name == "omega_e"),
                )
            )
            differences = [beside[term] - base[term] for term in terms]
            moved = np.column_stack(differences) @ coefficients / scale
        changes = 1 + int(np.count_nonzero(np.diff(values)))
        score = weighted * moved[:, None]
        found += bread @ (score.T @ score) @ bread * (kept.sum() / changes) / 12.0
        seen = np.abs(moved) > 0.0
        noise = float(np.sqrt(np.mean(left[seen] ** 2))) if seen.any() else math.inf
        if noise < 0.5 * float(np.sqrt(np.mean(moved[seen] ** 2))):
            told.append(
                f"{', '.join(rows.runs)}: column {'speed' if name == 'omega_e' else name} has "
                f"steps of {step:.3g} {_STEP_UNITS[name]}, more than its noise; intervals are no "
                "smaller than that allows"
            )
    return found, told


# Repeats: parameters of one machine that are not the same in each run.

# Runs differ where a parameter does by so many standard deviations and by that share.
_APART, _LEAST_DRIFT = 4.0, 3e-3


def _drift(rows: SteadyRows, model: _Model, terms: Sequence[str]) -> list[str]:
    """Sentences on what differs from run to run, of the terms that each run can have its own of."""
    found: list[str] = []
    of_run = [model.series % len(rows.runs) == place for place in range(len(rows.runs))]
    for key in _BASE if len(rows.runs) > 1 else ():
        own = [np.where(kept, model.columns[key], 0.0) for kept in of_run]
        columns = np.column_stack([*own, *(model.columns[term] for term in terms if term != key)])
        if not separable(columns).all():
            continue
        fit = regress(columns, model.values, model.series)
        values = fit.coefficients[: len(own)]
        low, high = int(np.argmin(values)), int(np.argmax(values))
        apart = np.zeros(columns.shape[1])
        apart[high], apart[low] = 1.0, -1.0
        gap, sigma = values[high] - values[low], math.sqrt(apart @ fit.covariance @ apart)
        if gap > _APART * sigma and gap > _LEAST_DRIFT * abs(float(np.mean(values))):
            label, unit = TERMS[key]
            first, last = sorted((low, high))
            found.append(
                f"{rows.runs[last]}: drift between repeats: {label} {values[last]:.4g} {unit}, "
                f"{values[first]:.4g} {unit} in {rows.runs[first]} ({gap / sigma:.2g} standard "
                "deviations); the interval does not hold both: let the machine cool, or log its "
                "temperature"
            )
    return found


def _at_least(covariance: FloatArray, floor: FloatArray) -> FloatArray:
    """A covariance widened, correlations kept, until no variance is below that of ``floor``."""
    have, least = np.diag(covariance), np.diag(floor)
    wider = np.sqrt(np.maximum(1.0, least / np.maximum(have, 1e-300)))
    return np.asarray(covariance * np.outer(wider, wider))


def _parameter(
    rows: SteadyRows, model: _Model, term: str, place: int, fit: _Found, reason: str
) -> Parameter:
    label, unit = TERMS[term]
    if term == "resistance" and model.mean_temperature is not None:
        label = f"{label} at {model.mean_temperature:.0f} degC"
    return judged(
        (term, label, unit),
        float(fit.coefficients[place]),
        float(np.sqrt(fit.covariance[place, place])),
        fit.freedom,
        runs=rows.runs,
        reason=reason,
        may_vanish=term in _MAY_VANISH,
        physical=term in ("resistance", "magnet_flux", "inductance_d", "inductance_q"),
    )


def _quadrants(rows: SteadyRows) -> tuple[BoolArray, BoolArray]:
    """Rows that drive, and rows that brake, each of shape (N,)."""
    power = rows.i_q * rows.omega_e
    least = _NONE * float(np.max(np.abs(power)))
    return power > least, power < -least


def _one_quadrant(quadrants: tuple[BoolArray, BoolArray]) -> str:
    """Name of the only quadrant, '' where both have rows."""
    motoring, braking = (int(each.sum()) for each in quadrants)
    if min(motoring, braking) >= _FEW * max(motoring + braking, 1):
        return ""
    return "motoring" if motoring > braking else "braking"


def _reasons(
    rows: SteadyRows,
    terms: Sequence[str],
    fit: _Found,
    quadrants: tuple[BoolArray, BoolArray],
) -> dict[str, str]:
    """What the rows cannot hold, whatever the errors say, by term."""
    found = {}
    only = _one_quadrant(quadrants)
    if only:
        found["resistance"] = (
            f"only {only} rows: the fall of psi_d with |i_q| changes the apparent resistance by "
            "|c| w, up to 17 % on bench rides; log both quadrants"
        )
    level = rows.current
    flowing = level > _NONE * float(level.max())
    if float(np.ptp(level[flowing])) < 0.2 * float(level.max()):
        text = "one amplitude of the current: resistance and inverter voltage cannot be told apart"
        found |= {"resistance": text, "inverter_voltage": text}
    speed = np.abs(rows.omega_e)
    one_speed = float(np.ptp(rows.omega_e)) < 0.1 * float(speed.max())
    if one_speed and "offset_q" in terms:
        found["offset_q"] = "one speed: an offset and the magnet flux linkage look the same"
    if rows.temperature is not None and _range_k(rows) < _LEAST_RANGE_K:
        found["resistance_slope"] = _narrow(rows)
    for place, term in enumerate(terms):
        if fit.own[place] < 1e-3 and term not in found:
            found[term] = "it moves with other terms in all rows; vary current, speed and sign"
    return found


def _range_k(rows: SteadyRows) -> float:
    """By how much the temperature of the winding changes."""
    return 0.0 if rows.temperature is None else float(np.ptp(rows.temperature))


def _narrow(rows: SteadyRows) -> str:
    return (
        f"the temperature changes by {_range_k(rows):.2g} K; a coefficient needs "
        f"{_LEAST_RANGE_K:.0f} K"
    )


def _absent(term: str, rows: SteadyRows, open_terms: Sequence[str]) -> Parameter:
    """A term that the model does not have, and why."""
    why = "the data do not support the term: it gains less than 6 in BIC"
    if term == "encoder_angle":
        why = (
            "psi_q without current shows it where u_d is logged in both directions and with both "
            "signs of i_q; else points at +-i_q of a flux map, or an offset sweep"
        )
    elif term == "inductance_d" and rows.i_d is None:
        why = "no d current was logged"
    elif term == "inductance_d" and rows.i_d is not None:
        spread, largest = float(np.ptp(rows.i_d)), float(rows.current.max())
        if spread < _NONE * largest:
            why = f"i_d changes by {spread:.2g} A of {largest:.3g} A; run with i_d"
    elif term in ("inductance_q", "offset_d") and rows.u_d is None:
        why = "no d voltage was logged"
    elif term == "resistance_slope" and rows.temperature is None:
        why = "no temperature was logged"
    elif term == "resistance_slope" and _range_k(rows) < _LEAST_RANGE_K:
        why = _narrow(rows)
    elif term not in open_terms:
        why = "the voltages are measured: they hold no error of the inverter"
    return unknown((term, *TERMS[term]), why)


def _as_angle(terms: Sequence[str], fit: _Found, angle: float) -> _Found:
    """What is found with psi_q without current as the angle that turns it out of psi_pm, beside
    the one that rows were turned by.
    """
    if "encoder_angle" not in terms:
        return fit
    at = terms.index("encoder_angle")
    scale = np.ones(len(terms))
    scale[at] = -1.0 / float(fit.coefficients[terms.index("magnet_flux")])
    coefficients = fit.coefficients * scale
    coefficients[at] += angle
    covariance = fit.covariance * np.outer(scale, scale)
    return replace(fit, coefficients=coefficients, covariance=covariance)


# An angle in rad that is told: a degree makes 0.02 % of the torque, and moves L_d and L_q.
_TOLD_ANGLE = math.radians(1.0)


def _with_coefficient(
    rows: SteadyRows,
    model: _Model,
    terms: Sequence[str],
    fit: _Found,
    parameters: list[Parameter],
    covariance: FloatArray,
) -> tuple[list[Parameter], FloatArray]:
    """Parameters with the temperature coefficient at 20 degC, where the slope is a term."""
    if "resistance_slope" not in terms or model.mean_temperature is None:
        return parameters, covariance
    at, slope_at = terms.index("resistance"), terms.index("resistance_slope")
    resistance, slope = fit.coefficients[at], fit.coefficients[slope_at]
    cold = resistance - slope * (model.mean_temperature - 20.0)
    gradient = np.zeros(fit.coefficients.size)
    gradient[at] = -slope / cold**2
    gradient[slope_at] = 1.0 / cold + slope * (model.mean_temperature - 20.0) / cold**2
    row = gradient @ covariance
    variance = float(row @ gradient)
    found = judged(
        ("temperature_coefficient", "temperature coefficient of the resistance at 20 degC", "1/K"),
        float(slope / cold),
        float(np.sqrt(variance)),
        fit.freedom,
        runs=rows.runs,
        reason=_narrow(rows) if _range_k(rows) < _LEAST_RANGE_K else "",
    )
    whole = np.block([[covariance, row[:, None]], [row[None, :], np.array([[variance]])]])
    return [*parameters, found], whole


def _over_temperature(
    rows: SteadyRows, model: _Model, terms: Sequence[str], fit: _Found
) -> OverTemperature | None:
    """The resistance over the temperatures of the rows, where its slope is a term."""
    if (
        "resistance_slope" not in terms
        or rows.temperature is None
        or model.mean_temperature is None
    ):
        return None
    at = [terms.index("resistance"), terms.index("resistance_slope")]
    temperature = np.linspace(float(rows.temperature.min()), float(rows.temperature.max()), 25)
    warmer = temperature - model.mean_temperature
    gradient = np.column_stack([np.ones(warmer.size), warmer])
    value = gradient @ fit.coefficients[at]
    covariance = fit.covariance[np.ix_(at, at)]
    half = student_95(fit.freedom) * np.sqrt(np.sum(gradient @ covariance * gradient, axis=1))
    cold = 1.0 + COPPER * (model.mean_temperature - 20.0)
    copper = fit.coefficients[at[0]] * (1.0 + COPPER * (temperature - 20.0)) / cold
    label = TERMS["resistance"][0]
    return OverTemperature(label, "Ohm", temperature, value, value - half, value + half, copper)


def _told(
    rows: SteadyRows,
    model: _Model,
    fit: _Found,
    parameters: Sequence[Parameter],
    known: Mapping[str, tuple[float, str]],
) -> tuple[list[str], list[str]]:
    remarks: list[str] = []
    contradictions: list[str] = []
    names = ", ".join(rows.runs)
    by_key = {parameter.key: parameter for parameter in parameters}
    two_term = _regression(model, list(_BASE))
    few, all_of = (
        float(np.sqrt(np.mean((each.residuals * model.scale)[model.axis == 0] ** 2)))
        for each in (two_term, fit)
    )
    remarks.append(
        f"{names}: R i + w psi alone leaves {1e3 * few:.3g} mV r.m.s. of u_q, the chosen terms "
        f"{1e3 * all_of:.3g} mV"
    )
    remarks += _quadrants_told(rows, names, by_key["resistance"])
    coefficient = by_key.get("temperature_coefficient")
    if coefficient is not None and coefficient.status == "identified":
        slack = _PURITY * COPPER
        is_copper = coefficient.low - slack <= COPPER <= coefficient.high + slack
        remarks.append(
            f"{names}: the temperature coefficient is {'that' if is_copper else 'not that'} of "
            f"copper, {COPPER} 1/K"
            + ("" if is_copper else "; the temperature is not the winding's, or a part is constant")
        )
    ratios = {
        key: by_key[key].value / value
        for key, (value, _) in known.items()
        if key in by_key and by_key[key].value > 0.0
    }
    for key, (value, origin) in known.items():
        if key in by_key:
            text, against = compared(by_key[key], value, origin)
            if against:
                contradictions.append(f"{names}: {text}; look at {suspected(ratios)}")
            elif text:
                remarks.append(f"{names}: {text}")
    return remarks, contradictions


def _quadrants_told(rows: SteadyRows, names: str, whole: Parameter) -> list[str]:
    """Resistances that each quadrant alone would give by the usual two terms."""
    quadrants = _quadrants(rows)
    if _one_quadrant(quadrants):
        return []
    alone = []
    for kept in quadrants:
        part = rows.some(kept)
        if kept.sum() < 3 * len(_BASE) or rows_fault(part):
            return []
        alone.append(float(_regression(_model(part), list(_BASE)).coefficients[0]))
    half = 0.5 * (whole.high - whole.low)
    if max(abs(each - whole.value) for each in alone) <= half:
        return []
    text = (
        f"{names}: by two terms motoring alone gives {1e3 * alone[0]:.4g} mOhm and braking alone "
        f"{1e3 * alone[1]:.4g} mOhm, against {1e3 * whole.value:.4g} mOhm by all terms; one "
        "quadrant is not enough"
    )
    return [text]


def _residuals(rows: SteadyRows, model: _Model, fit: _Found) -> list[RunResiduals]:
    found = []
    for place, run in enumerate(rows.runs):
        for axis, name in enumerate(("u_q", "u_d") if rows.u_d is not None else ("u_q",)):
            kept = model.series == place + axis * len(rows.runs)
            values = (fit.residuals * model.scale)[kept]
            time = correlation_time(values, np.zeros(values.size, dtype=np.intp))
            rms = float(np.sqrt(np.mean(values**2)))
            found.append(RunResiduals(run, name, "V", rms, values.size, values.size / time, values))
    return found
