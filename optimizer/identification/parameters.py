"""What identification says: parameters with intervals, and whether the logs hold them at all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import stats

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

Status = Literal["identified", "prior-dominated", "not identified"]

# An interval that is wider than this share of the value to either side says next to nothing of it.
WIDEST_SHARE = 0.5
# Two parameters whose estimates move together this closely are named as partners.
_PARTNERS = 0.7
# Two routes to one parameter that differ by more cannot both be right, whatever their intervals:
# data sheets promise 10 % of a magnet flux linkage, and a magnet loses 5 % from 20 to 70 degC.
CONTRADICTION = 1.15
# Ratios that one convention taken for another leaves behind, and how close is close.
_RATIOS = (
    (2.0, "2: line-to-line taken for phase, or the reverse"),
    (1.5, "3/2: power-invariant or two-phase quantities taken for amplitudes, or the reverse"),
    (math.sqrt(3.0), "sqrt(3): line-to-line taken for phase voltage, or the reverse"),
    (math.sqrt(2.0), "sqrt(2): r.m.s. taken for peak, or the reverse"),
    (math.sqrt(1.5), "sqrt(3/2): power-invariant taken for amplitude-invariant, or the reverse"),
)
_CLOSE_RATIO = 0.02


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter and what the logs say of it.

    Args:
        key: Its name in results; that of the design's key where there is one.
        label: What it is.
        unit: SI unit.
        value, low, high: Estimate and its 95 % interval; NaN where there is none.
        sigma: Standard deviation, for correlated residuals.
        status: Whether the logs hold it.
        why: What the status rests on, or what is missing.
        partners: Parameters whose estimates move with it, and the correlation.
        runs: Runs that hold it.
        moved: Of three runs or more that without which it moves most, and how far in the standard
            deviation that the others leave: its own grows with a run that does not belong.
    """

    key: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    sigma: float
    status: Status
    why: str
    partners: tuple[tuple[str, float], ...] = ()
    runs: tuple[str, ...] = ()
    moved: tuple[str, float] | None = None


@dataclass(frozen=True, slots=True)
class RunResiduals:
    """What a model leaves of a run: rows, their values in ``unit`` and the r.m.s. value."""

    run: str
    quantity: str
    unit: str
    rms: float
    rows: int
    effective: float
    values: FloatArray


@dataclass(frozen=True, slots=True)
class OverTemperature:
    """A parameter over the temperatures of the runs (degC), with its 95 % interval, and ``copper``,
    what copper would make of its value in the middle; each of shape (N,).
    """

    label: str
    unit: str
    temperature: FloatArray
    value: FloatArray
    low: FloatArray
    high: FloatArray
    copper: FloatArray


@dataclass(frozen=True, slots=True)
class Analysis:
    """What one kind of evaluation finds in the runs that are of its kind.

    Args:
        name: Kind of the runs.
        parameters: K parameters.
        covariance: Shape (K, K), NaN for what has no estimate.
        residuals: Of each run.
        remarks: Sentences on what was found besides.
        contradictions: Sentences on what cannot be; nothing may be taken from these runs.
        terms: The terms that the model has, and those that the data do not support.
        over_temperature: A parameter that changes with it; None where none does.
    """

    name: str
    parameters: tuple[Parameter, ...]
    covariance: FloatArray
    residuals: tuple[RunResiduals, ...] = ()
    remarks: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    over_temperature: OverTemperature | None = None

    def of(self, key: str) -> Parameter | None:
        """A parameter by its key."""
        return next((one for one in self.parameters if one.key == key), None)


def student_95(freedom: float) -> float:
    """Half width of a 95 % interval in standard deviations, for an effective number of degrees of
    freedom.
    """
    return float(stats.t.ppf(0.975, max(freedom, 1.0)))


# What an estimate lacks that is right but wide.
_HOLDS_ZERO = "the 95 % interval holds 0"
_TOO_WIDE = "the 95 % interval is wider than half of the value"

Named = tuple[str, str, str]  # key, label and SI unit of a parameter


def judged(
    named: Named,
    value: float,
    sigma: float,
    freedom: float,
    *,
    runs: Sequence[str] = (),
    reason: str = "",
    may_vanish: bool = False,
    physical: bool = True,
) -> Parameter:
    """A parameter with its interval and status.

    Args:
        named: Key, label and unit.
        value, sigma, runs: As in `Parameter`.
        freedom: Effective degrees of freedom of ``sigma``.
        reason: Why the data cannot hold it however small ``sigma`` is; '' where they can.
        may_vanish: Whether zero is a value like others, such as of an offset.
        physical: Whether it must be above zero, as resistances and inductances are.
    """
    half = student_95(freedom) * sigma
    low, high = value - half, value + half
    status: Status = "not identified" if reason else "identified"
    why = reason
    if not reason and not (math.isfinite(value) and math.isfinite(sigma)):
        status, why = "not identified", "no estimate"
    elif not reason and not may_vanish:
        if low <= 0.0 <= high:
            status, why = "not identified", _HOLDS_ZERO
        elif half > WIDEST_SHARE * abs(value):
            status, why = "not identified", _TOO_WIDE
        elif physical and value < 0.0:
            status, why = "not identified", "below 0, which it cannot be"
    return Parameter(*named, value, low, high, sigma, status, why, (), tuple(runs))


def unknown(named: Named, why: str) -> Parameter:
    """A parameter without an estimate, and why."""
    nan = float("nan")
    return Parameter(*named, nan, nan, nan, nan, "not identified", why)


def with_partners(parameters: Sequence[Parameter], covariance: FloatArray) -> list[Parameter]:
    """Parameters with those that their estimates are strongly correlated with."""
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(sigma, sigma)
    found = []
    for place, parameter in enumerate(parameters):
        partners = tuple(
            (other.key, float(correlation[place, column]))
            for column, other in enumerate(parameters)
            if column != place and abs(correlation[place, column]) >= _PARTNERS
        )
        found.append(replace(parameter, partners=partners))
    return found


def mean_of_routes(held: Sequence[Parameter]) -> tuple[Parameter, float]:
    """Mean of several estimates weighted by inverse variance, and the factor by which their
    scatter widens its interval, as of the Particle Data Group.
    """
    values, sigmas = (np.array([getattr(one, name) for one in held]) for name in ("value", "sigma"))
    halves = np.array([0.5 * (one.high - one.low) for one in held])
    weights = sigmas**-2.0 / np.sum(sigmas**-2.0)
    value = float(weights @ values)
    chi2 = float(np.sum(((values - value) / sigmas) ** 2)) / (values.size - 1)
    scale = max(1.0, math.sqrt(chi2))
    sigma = scale * float(np.sum(sigmas**-2.0)) ** -0.5
    half = scale * float(np.sqrt(np.sum((weights * halves) ** 2)))
    runs = tuple(dict.fromkeys(run for one in held for run in one.runs))
    mean = replace(
        held[0], value=value, sigma=sigma, low=value - half, high=value + half, runs=runs
    )
    return mean, scale


def with_prior(found: Parameter, prior: float, half: float, origin: str) -> tuple[Parameter, float]:
    """A parameter averaged with what is known of it by inverse variance, and the factor of
    `mean_of_routes`.

    Where its estimate is missing, or its runs cannot tell it from another, the prior stands alone.
    A mean of which the prior is more than half is prior-dominated.

    Args:
        found: What the runs say.
        prior: What is known.
        half: Half the 95 % interval of that, above 0.
        origin: Where that is written.
    """
    known = replace(
        found,
        value=prior,
        low=prior - half,
        high=prior + half,
        sigma=half / student_95(math.inf),
        status="prior-dominated",
        why=f"from {origin} with its interval" + (f": {found.why}" if found.why else ""),
        partners=(),
        runs=(),
    )
    usable = found.status == "identified" or found.why in (_HOLDS_ZERO, _TOO_WIDE)
    if not usable or not found.sigma > 0.0:
        return known, 1.0
    share = known.sigma**-2.0 / (known.sigma**-2.0 + found.sigma**-2.0)
    mean, scale = mean_of_routes((found, known))
    return replace(
        mean,
        status="prior-dominated" if share > 0.5 else "identified",
        why=f"{100.0 * share:.2g} % of the weight is that of {origin}",
    ), scale


def named_ratio(ratio: float) -> str:
    """What a ratio of two routes may come from, '' where no convention is near."""
    size = max(ratio, 1.0 / ratio)
    return next((text for value, text in _RATIOS if abs(size / value - 1.0) <= _CLOSE_RATIO), "")


def suspected(ratios: Mapping[str, float]) -> str:
    """Which columns a wrong factor stands in, by what it does to resistance and flux linkage.

    Args:
        ratios: Found over known values by key of a parameter.
    """

    def off(ratio: float) -> bool:
        return max(ratio, 1.0 / ratio) > CONTRADICTION

    resistance, flux = ratios.get("resistance"), ratios.get("magnet_flux")
    if resistance is None or flux is None:
        return "columns of currents, voltages or speed"
    if off(resistance) and off(flux):
        alike = abs(resistance / flux - 1.0) < 0.1
        return "columns u_d and u_q" if alike else "more than one column"
    return (
        "columns i_d and i_q, or machine.resistance"
        if off(resistance)
        else "column speed, machine.pole_pairs or the magnet flux linkage under machine"
    )


def compared(found: Parameter, other: float, origin: str) -> tuple[str, bool]:
    """A sentence on two routes to one parameter, and whether they contradict each other.

    Args:
        found: What the runs say.
        other: The other value, above 0.
        origin: Where that comes from.
    """
    if not (math.isfinite(found.value) and found.value > 0.0 and other > 0.0):
        return "", False
    ratio = found.value / other
    size = max(ratio, 1.0 / ratio)
    cause = named_ratio(ratio)
    told = f" (near {cause})" if cause else ""
    if size > CONTRADICTION and not found.low <= other <= found.high:
        text = (
            f"{found.label}: two routes differ by a factor of {size:.2f}{told}: {found.value:.4g} "
            f"{found.unit} from the runs, {other:.4g} {found.unit} from {origin}"
        )
        return text, True
    within = "within" if found.low <= other <= found.high else "outside"
    share = 100.0 * (ratio - 1.0)
    side = "above" if share >= 0.0 else "below"
    text = (
        f"{found.label}: {abs(share):.1f} % {side} {other:.4g} {found.unit} from {origin}, which "
        f"lies {within} the interval"
    )
    return text, False
