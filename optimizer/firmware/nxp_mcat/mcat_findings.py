"""What in a file of MCAT does not fit together, and how its numbers are to be understood."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.nxp_mcat.mcat_constants import SPEED_I, SPEED_P, constants
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import OLD_PLACES, counts, half_step
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import TURN, McatSheet, kind_of

MOST = 8  # So many constants that do not follow from the inputs are named each by itself.
LOST_IN_COUNTS = 0.02  # Share of a gain that is named where its integer cuts off more.
_GAINS = ("M1_D_KP_GAIN", "M1_D_KI_GAIN", "M1_Q_KP_GAIN", "M1_Q_KI_GAIN", SPEED_P, SPEED_I)
Span = tuple[float, float]


def contradictions(sheet: McatSheet) -> tuple[str, ...]:
    """Sentences on what does not fit together, with both numbers.

    Args:
        sheet: Inputs and constants of the file.
    """
    wrong = mismatches(sheet)
    rounded = tuple(_rounded_inputs(sheet)) if wrong else ()
    if rounded:
        wrong = mismatches(replace(sheet, own=_with_implied(sheet)), loose=True)
    return (*rounded, *_by_hand(sheet, wrong), *_speed_filter(sheet), *_cut_off(sheet))


def mismatches(sheet: McatSheet, *, loose: bool = False) -> dict[str, float]:
    """What MCAT makes of the inputs, of the constants that stand there with another value.

    Args:
        sheet: Inputs and constants.
        loose: Whether inputs are only known to what is printed of the constants.
    """
    found = {}
    for name, made in constants(sheet.edition, sheet.own).items():
        stands = sheet.number(name)
        if stands is None:
            continue
        allowed = 2.05 * _half(sheet, made) + (2e-4 * abs(made) if loose else 0.0)
        if abs(stands - made) > allowed:
            found[name] = made
    return found


def implied_spans(sheet: McatSheet) -> dict[str, Span]:
    """Between which values the inputs of the machine lie, by what the constants of the current
    loop are printed as: ``parametersLd``, ``parametersLq`` in H, ``parametersRs`` in Ohm.
    """
    f_0, ksi = sheet.number("currentLoopF0"), sheet.number("currentLoopKsi")
    t_s, volts, amperes = sheet.t_s, sheet.volts, sheet.amperes
    if not f_0 or ksi is None or not t_s or not volts or not amperes:
        return {}
    rate = TURN * f_0
    scale = volts / amperes
    spans: dict[str, Span] = {}
    for axis, key in (("D", "parametersLd"), ("Q", "parametersLq")):
        k_i, k_p = sheet.number(f"M1_{axis}_KI_GAIN"), sheet.number(f"M1_{axis}_KP_GAIN")
        if k_i is None or k_p is None:
            continue
        unit = scale / (rate * rate * t_s * sheet.edition.current_share)
        half = _half(sheet, k_i)
        low, high = (k_i - half) * unit, (k_i + half) * unit
        spans[key] = (low, high)
        half = _half(sheet, k_p)
        r_s = (
            2.0 * ksi * rate * low - (k_p + half) * scale,
            2.0 * ksi * rate * high - (k_p - half) * scale,
        )
        before = spans.get("parametersRs", r_s)
        spans["parametersRs"] = (max(before[0], r_s[0]), min(before[1], r_s[1]))
    return spans


def conventions(sheet: McatSheet) -> tuple[str, ...]:
    """Sentences on how the numbers are to be understood.

    Args:
        sheet: Inputs and constants of the file.
    """
    share = sheet.edition.current_share
    integral = "ki T/2 (trapezoids)" if share == 0.5 else "ki T (rectangles)"
    said = [
        f"M1_D_KI_GAIN and M1_Q_KI_GAIN are {integral}, as MCAT {sheet.edition.version} makes them",
        "speeds and speed gains count in electrical rad/s; currents are peak of phase",
    ]
    if sheet.edition.fixed:
        said.append(
            "fractions of I_MAX, of U_DCB_MAX/sqrt(3) and of N_MAX; gains count as the integers "
            "that FRAC16 (2^-15), FRAC32 (2^-31) and ACC32 (2^-15) cut them off to"
        )
    if sheet.psi_pm() is not None:
        said.append(_about_flux(sheet))
    if sheet.link_voltage() is not None:
        said.append(
            "the file does not say the DC-link voltage: sqrt(3) times the nominal phase voltage "
            "parametersUphNom stands for it"
        )
    elif (phase := sheet.number("parametersUphNom")) is not None:
        said.append(
            f"the file does not say the DC-link voltage: sqrt(3) times parametersUphNom "
            f"{phase:g} V is one at which the firmware switches off, outside of "
            f"{sheet.number('parametersUdcbUnder') or 0.0:g} to "
            f"{sheet.number('parametersUdcbOver') or 0.0:g} V: give it"
        )
    if sheet.own.get("parametersRs") is None and sheet.implied():
        said.append("R, L_d and L_q are those that the constants of the observer are made of")
    return tuple(said)


def _about_flux(sheet: McatSheet) -> str:
    torque = sheet.torque() or 0.0
    if sheet.edition.fixed or sheet.edition.current_share == 0.5:
        key = "parametersKt" if "parametersKt" in sheet.own else "parametersKe"
        return f"psi_pm is that of the torque constant {torque:.6g} N m/A (peak) in {key}"
    return (
        "parametersKe has no stated kind (files hold V s/rad and V/Hz); psi_pm is that of the "
        f"torque constant sqrt(3) Ke = {torque:.6g} N m/A that MCAT's rule for the speed loop "
        "takes: measure psi_pm before relying on it"
    )


def _half(sheet: McatSheet, value: float) -> float:
    """Half of the last printed digit; old gains are printed whole."""
    if sheet.edition.commented:
        return max(half_step(value, OLD_PLACES), 1e-11 * abs(value))
    return half_step(value)


def _rounded_inputs(sheet: McatSheet) -> Iterator[str]:
    """Inputs that their own constants contradict, where all constants agree on other ones."""
    spans = implied_spans(sheet)
    outside = {
        key: span
        for key, span in spans.items()
        if (given := sheet.number(key)) is not None
        and span[0] <= span[1]
        and not span[0] * (1 - 1e-6) <= given <= span[1] * (1 + 1e-6)
    }
    if not outside or not _agreed(sheet):
        return
    for key, (low, high) in outside.items():
        unit, factor = ("Ohm", 1.0) if key == "parametersRs" else ("mH", 1e3)
        yield (
            f"{key} is {factor * (sheet.number(key) or 0.0):.6g} {unit} among the inputs, but the "
            f"constants are made of {factor * low:.6g} to {factor * high:.6g} {unit}: the inputs "
            f"were rounded or changed afterwards, and MCAT would make other constants of them"
        )
    yield from _speed_inputs(sheet)


def _agreed(sheet: McatSheet) -> bool:
    """Whether observer and current loop are made of one machine: then no gain was edited."""
    wrong = mismatches(replace(sheet, own=_with_implied(sheet)), loose=True)
    observer = ("M1_I_SCALE", "M1_U_SCALE", "M1_BEMF_DQ_KP_GAIN", "M1_BEMF_DQ_KI_GAIN")
    there = [name for name in observer if sheet.number(name) is not None]
    return bool(there) and not any(name in wrong for name in (*there, *_GAINS[:4]))


def _with_implied(sheet: McatSheet) -> Mapping[str, OwnValue]:
    """The inputs with those of the machine that the constants are made of."""
    middle = {key: 0.5 * (low + high) for key, (low, high) in implied_spans(sheet).items()}
    ratio = _speed_ratio(sheet)
    inertia = sheet.number("parametersJ")
    if ratio is not None and inertia is not None:
        middle["parametersJ"] = inertia * ratio
    return {**sheet.own, **middle}


def _speed_ratio(sheet: McatSheet) -> float | None:
    """By what both speed gains differ from those of the inputs, None where by different shares."""
    made = constants(sheet.edition, sheet.own)
    k_p, k_i = sheet.number(SPEED_P), sheet.number(SPEED_I)
    if not k_p or not k_i or not made.get(SPEED_P) or not made.get(SPEED_I):
        return None
    first, second = k_p / made[SPEED_P], k_i / made[SPEED_I]
    return 0.5 * (first + second) if abs(first - second) < 2e-5 * first else None


def _speed_inputs(sheet: McatSheet) -> Iterator[str]:
    ratio, inertia, torque = _speed_ratio(sheet), sheet.number("parametersJ"), sheet.torque()
    if ratio is None or not inertia or not torque or abs(ratio - 1.0) < 1e-5:
        return
    yield (
        f"both speed gains are made of J/Kt = {ratio * inertia / torque:.6g} A s^2, the inputs "
        f"say {inertia / torque:.6g} A s^2"
    )


def _by_hand(sheet: McatSheet, wrong: Mapping[str, float]) -> Iterator[str]:
    for name, made in list(wrong.items())[:MOST]:
        yield (
            f"{name} is {sheet.number(name):.6g}, not {made:.6g} as MCAT makes it of the inputs: "
            f"edited by hand, or not made by its rule"
        )
    if len(wrong) > MOST:
        yield f"{len(wrong) - MOST} more constants do not follow from the inputs"


def _speed_filter(sheet: McatSheet) -> Iterator[str]:
    """Until 2024 MCAT made the speed filter for the fast period, the firmware runs it slowly."""
    given, b_0 = sheet.number("speedLoopCutOffFreq"), sheet.constant("M1_SPEED_IIR_B0")
    t_s, t_speed = sheet.t_s, sheet.t_speed
    if sheet.edition.fixed or sheet.edition.current_share == 0.5 or not b_0 or b_0 >= 1.0:
        return
    if not t_s or not t_speed or t_speed <= t_s:
        return
    meant = 2.0 * b_0 / (1.0 - b_0) / (TURN * t_s)
    runs = 2.0 * b_0 / (1.0 - b_0) / (TURN * t_speed)
    meant = meant if given is None or not math.isclose(meant, given, rel_tol=1e-4) else given
    yield (
        f"M1_SPEED_IIR_B0 {b_0:.6g} makes a cut-off of {meant:.4g} Hz with the period of the "
        f"current loop ({1e6 * t_s:.4g} us), but the speed filter runs with that of the speed loop "
        f"({1e3 * t_speed:.4g} ms): it cuts off at {runs:.4g} Hz"
    )


def _cut_off(sheet: McatSheet) -> Iterator[str]:
    """Gains of which the integers of a fixed-point build lose something."""
    if not sheet.edition.fixed:
        return
    for name in _GAINS:
        value, holds = sheet.number(name), sheet.constant(name)
        if not value or holds is None or 1.0 - holds / value < LOST_IN_COUNTS:
            continue
        left = counts(value, kind_of(name, sheet.edition))
        yield (
            f"{name} {value:.6g} becomes {left} steps of 2^-15 in the firmware: "
            f"{100.0 * (1.0 - holds / value):.2g} % of it are cut off"
        )
