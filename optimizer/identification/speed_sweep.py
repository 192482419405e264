"""Flux linkage of the d axis from levels of current that were each run at several speeds.

At one level the voltage u_q = w psi_d + (what does not depend on the speed): the slope over the
electrical speed is the flux linkage, and resistance, dead time and offsets fall out with the
intercept of the level. Over the levels psi_d = psi_pm + L_d i_d + C i_d^2.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import (
    BIC_GAIN,
    Groups,
    correlation_time,
    information,
    regress,
)
from dqforge.optimizer.identification.parameters import (
    Analysis,
    Parameter,
    RunResiduals,
    compared,
    judged,
    with_partners,
)

# Currents closer than this share of their range are one level.
_SAME_LEVEL = 0.02
# Speeds of a level must differ by this share of the largest for a slope.
_LEAST_SPREAD = 0.1
_MOST_DEGREE = 3
# The r.m.s. residual of a sound sweep is some per mille of the voltage; moteus's sound motors have
# 0.1 to 0.4 %.
_NOISY = 0.01
_KEYS = (
    ("magnet_flux", "magnet flux linkage", "Wb"),
    ("inductance_d", "d-axis inductance at i_d = 0", "H"),
    ("inductance_d_slope", "change of psi_d with i_d^2", "H/A"),
    ("inductance_d_curve", "change of psi_d with i_d^3", "H/A^2"),
)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Rows of a sweep: d current (A), electrical speed (rad/s), voltage of the q axis (V) without
    what is known of the drop; each of shape (N,).
    """

    run: str
    i_d: FloatArray
    omega_e: FloatArray
    u_q: FloatArray


def levels_of(currents: FloatArray) -> Groups:
    """Label of each row's level of current, shape (N,), levels in ascending order of current."""
    order = np.argsort(currents, kind="stable")
    steps = np.diff(currents[order])
    width = _SAME_LEVEL * max(float(np.ptp(currents)), 1e-12)
    found = np.empty(currents.size, dtype=np.intp)
    found[order] = np.concatenate([[0], np.cumsum(steps > width)])
    return found


@dataclass(frozen=True, slots=True)
class _Fit:
    """Coefficients of a degree, shape (K,), their covariance, effective degrees of freedom of each,
    and the residuals.
    """

    coefficients: FloatArray
    covariance: FloatArray
    freedom: FloatArray
    residuals: FloatArray
    rms: float


def _fit(sweep: Sweep, levels: Groups, degree: int) -> _Fit:
    """Least squares, with errors of two kinds: those of rows, and one of psi_d that all rows of a
    level share, such as of its current.

    Rows alone would make 95 % intervals that hold the truth in half of the cases, and the sandwich
    over so few levels in 80 of 100.
    """
    powers = np.column_stack([sweep.omega_e * sweep.i_d**power for power in range(degree + 1)])
    rows, speed, values = (
        _without_levels(each, levels)
        for each in (powers, sweep.omega_e[:, None], sweep.u_q[:, None])
    )
    size = np.linalg.norm(rows, axis=0)
    rows, values = rows / size, values[:, 0]
    bread = np.linalg.inv(rows.T @ rows)
    found = bread @ (rows.T @ values)
    residuals = values - rows @ found
    count, level_count, free = values.size, int(levels.max()) + 1, degree + 1
    by_level = speed * np.eye(level_count)[levels]
    slopes = (by_level.T @ values) / np.sum(by_level**2, axis=0)
    within = values - by_level @ slopes
    inner = max(count - 2 * level_count, 1)
    of_rows = float(within @ within) / inner
    shared = rows.T @ by_level
    seen = float(np.sum(by_level**2) - np.sum(shared * (bread @ shared)))
    excess = float(residuals @ residuals) - of_rows * (count - level_count - free)
    of_levels = max(excess / seen, 0.0)
    part_rows = of_rows * bread
    part_levels = of_levels * bread @ shared @ shared.T @ bread
    covariance = part_rows + part_levels
    # Satterthwaite's degrees of freedom of a sum of two variances.
    variance = np.diag(covariance)
    freedom = variance**2 / (
        np.diag(part_rows) ** 2 / inner + np.diag(part_levels) ** 2 / max(level_count - free, 1)
    )
    rms = float(np.sqrt(residuals @ residuals / max(count - level_count - free, 1)))
    return _Fit(found / size, covariance / np.outer(size, size), freedom, residuals, rms)


def _without_levels(columns: FloatArray, levels: Groups) -> FloatArray:
    """Columns less their mean at each level, which is what an offset for each takes away."""
    found = columns.copy()
    for level in np.unique(levels):
        found[levels == level] -= columns[levels == level].mean(axis=0)
    return found


def sweep_fault(sweep: Sweep) -> str:
    """Why a sweep says nothing, '' where it does."""
    levels = levels_of(sweep.i_d)
    count = int(levels.max()) + 1
    if count < 3:
        return f"{count} levels of i_d; it needs three, or is a run of kind constant-speed"
    largest = float(np.max(np.abs(sweep.omega_e)))
    for level in range(count):
        speeds = sweep.omega_e[levels == level]
        if speeds.size < 2 or float(np.ptp(speeds)) < _LEAST_SPREAD * largest:
            current = float(sweep.i_d[levels == level].mean())
            return f"the level of {current:.4g} A has one speed; a slope needs two"
    return ""


def analyse_sweep(sweep: Sweep, known_flux: tuple[float, str] | None) -> Analysis:
    """Magnet flux linkage and d inductance of a sweep that `sweep_fault` has nothing against.

    Args:
        sweep: The rows.
        known_flux: Another magnet flux linkage in Wb, and where it comes from.
    """
    levels = levels_of(sweep.i_d)
    count = int(levels.max()) + 1
    degrees = range(1, min(_MOST_DEGREE, count - 1) + 1)
    fits = {degree: _fit(sweep, levels, degree) for degree in degrees}
    chosen = _chosen_degree(fits, levels)
    fit = fits[chosen]
    parameters = [_parameter(fit, power, sweep.run, chosen) for power in range(chosen + 1)]
    covariance = fit.covariance
    if chosen == 1 and 2 in fits:
        parameters.append(_parameter(fits[2], 2, sweep.run, chosen))
        covariance = np.pad(covariance, (0, 1), constant_values=np.nan)
    parameters = with_partners(parameters, covariance)
    remarks, contradictions = _judgement(sweep, fit, parameters, known_flux)
    remarks += _offset_told(sweep, levels, chosen, parameters)
    residuals = RunResiduals(
        sweep.run,
        "u_q",
        "V",
        fit.rms,
        sweep.u_q.size,
        sweep.u_q.size / correlation_time(fit.residuals, levels),
        fit.residuals,
    )
    terms = (f"psi_d of degree {chosen} in i_d", f"an offset for each of {count} levels")
    return Analysis(
        "speed-sweep",
        tuple(parameters),
        covariance,
        (residuals,),
        tuple(remarks),
        tuple(contradictions),
        terms,
    )


def _chosen_degree(fits: dict[int, _Fit], levels: Groups) -> int:
    """The lowest degree over which the next gains nothing strongly in BIC."""
    last = fits[max(fits)]
    effective = levels.size / correlation_time(last.residuals, levels)
    scores = {
        degree: information(fit.residuals, fit.coefficients.size + int(levels.max()) + 1, effective)
        for degree, fit in fits.items()
    }
    chosen = min(scores)
    while chosen + 1 in scores and scores[chosen + 1] < scores[chosen] - BIC_GAIN:
        chosen += 1
    return chosen


def _parameter(fit: _Fit, power: int, run: str, chosen: int) -> Parameter:
    reason = ""
    if power > chosen:
        reason = "the data do not support the term: it gains less than 6 in BIC"
    return judged(
        _KEYS[power],
        float(fit.coefficients[power]),
        float(np.sqrt(fit.covariance[power, power])),
        float(fit.freedom[power]),
        runs=(run,),
        reason=reason,
        physical=power < 2,
    )


def _judgement(
    sweep: Sweep,
    fit: _Fit,
    parameters: list[Parameter],
    known_flux: tuple[float, str] | None,
) -> tuple[list[str], list[str]]:
    remarks: list[str] = []
    contradictions: list[str] = []
    size = float(np.sqrt(np.mean(sweep.u_q**2)))
    if fit.rms > _NOISY * size:
        remarks.append(
            f"{sweep.run}: the model leaves {1e3 * fit.rms:.3g} mV r.m.s., "
            f"{100.0 * fit.rms / size:.1f} % of the voltage; sound sweeps leave 0.1 to 0.4 %"
        )
    if known_flux is not None:
        text, against = compared(parameters[0], *known_flux)
        if text:
            (contradictions if against else remarks).append(f"{sweep.run}: {text}")
    return remarks, contradictions


def _offset_told(
    sweep: Sweep, levels: Groups, degree: int, parameters: list[Parameter]
) -> list[str]:
    """What one offset common to all levels would make of the inductance, where that matters."""
    powers = [sweep.omega_e * sweep.i_d**power for power in range(degree + 1)]
    rows = np.column_stack([*powers, np.ones(levels.size)])
    common = regress(rows, sweep.u_q, levels, robust=False)
    inductance = parameters[1]
    other = float(common.coefficients[1])
    if inductance.low <= other <= inductance.high:
        return []
    text = (
        f"{sweep.run}: {inductance.label} depends on the model of the offset: "
        f"{1e6 * inductance.value:.3g} uH with one offset for each level, {1e6 * other:.3g} uH "
        "with one for all; dead time and the resistance differ from level to level, so the first "
        "is taken"
    )
    return [text]
