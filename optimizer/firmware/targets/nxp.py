"""NXP's motor control (MCAT): its configuration for a design, and the loops that it then runs."""

from __future__ import annotations

import math

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    FluxObserver,
    LoopProfile,
    PiController,
    PiGains,
    PiRule,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import MAX_SPEED, Asked, FirmwareMethod
from dqforge.optimizer.firmware.nxp_mcat.mcat_design import own_values, shortfalls
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import (
    EDITIONS,
    FIXED_2022,
    FLOAT_2025,
    Edition,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import ROOT_3, McatFile, McatSheet

_HOME = "nxp-mcuxpresso/mcux-motor_control"

SOURCES = (
    f"{_HOME} pmsm/pmsm_float/mc_algorithms/pmsm_control.c: current and speed control",
    f"{_HOME} pmsm/pmsm_frac/mc_algorithms/pmsm_control.c: the same in fractions",
    f"{_HOME} pmsm/pmsm_float/mc_state_machine/m1_sm_snsless_enc.c: filters and periods",
    f"{_HOME} freemaster/pmsm_float and pmsm_frac, mcat.js: rules for the constants",
)


def configure(asked: Asked) -> Configuration:
    """The configuration for a design: MCAT of 2025, in float or in fixed point.

    Fixed point where the gains of the current loop are asked for in integers
    (``control.current_loop.q_formats``).

    Raises:
        InputError: A value that MCAT needs is missing, or does not fit its integers; with its key.
    """
    return configured(asked, edition_for(asked))


def edition_for(asked: Asked) -> Edition:
    """Which arithmetic the design asks for."""
    loop = asked.design.control.current_loop
    return FLOAT_2025 if loop.q_formats is None else FIXED_2022


def configured(asked: Asked, edition: Edition) -> Configuration:
    """The configuration for a design in the format of one age.

    Args:
        asked: The design and its gains.
        edition: The age of the format, and its arithmetic.
    """
    newest = FIXED_2022 if edition.fixed else FLOAT_2025
    made = McatFile(asked.design.name, newest, own_values(asked, newest))
    return made.in_edition(edition.version).configuration()


def profile(found: Configuration) -> LoopProfile:
    """The loops that NXP's motor control runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    sheet = McatSheet(EDITIONS[found.version], found.own)
    axes = found.current_d, found.current_q
    if axes[0] is None or axes[1] is None or sheet.t_s is None:
        missing = "period of the current loop" if sheet.t_s is None else "gains of both axes"
        raise InputError(
            f"the configuration of NXP has no {missing}; keep M1_D_KP_GAIN to M1_Q_KI_GAIN and the "
            f"inputs (or M1_TO_THETA_GAIN) in the file"
        )
    return LoopProfile(
        firmware="nxp",
        version=found.version,
        current=_current(axes[0], axes[1], sheet, sheet.t_s),
        speed=_speed(found, sheet, sheet.t_s),
        observer=_observer(sheet),
        sources=SOURCES,
    )


def _rule(share: float) -> PiRule:
    return "trapezoid" if share == 0.5 else "integral-first"


def _current(d: PiGains, q: PiGains, sheet: McatSheet, t_s: float) -> CurrentLoops:
    """The d axis limited first, q to what it leaves; integrals are held to these limits."""
    rule = _rule(sheet.edition.current_share)
    share = sheet.constant("M1_CLOOP_LIMIT")
    if share is not None and not sheet.edition.fixed:
        share *= ROOT_3
    return CurrentLoops(
        d=PiController(d.kp, d.ki, t_s, rule),
        q=PiController(q.kp, q.ki, t_s, rule),
        delay=1.0,
        order="d-first",
        voltage_share=0.9 if share is None else min(1.0, share),
    )


def _speed(found: Configuration, sheet: McatSheet, t_s: float) -> SpeedController | None:
    """The speed of the tracking observer through its filter, then through that of the slow loop."""
    period = sheet.t_speed
    if found.speed is None or period is None or not (found.speed.kp or found.speed.ki):
        return None
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        period,
        _rule(sheet.edition.speed_share),
        limit=found.drive.i_max,
        filter_time=_filter_time(sheet, "M1_SPEED_IIR", period),
    )
    return SpeedController(pi, _estimate(sheet, t_s), _ramp(sheet, period))


def _ramp(sheet: McatSheet, period: float) -> float | None:
    step, full, pairs = sheet.constant("M1_SPEED_RAMP_UP"), sheet.full_speed, sheet.pole_pairs
    return step * full / (pairs * period) if step and full and pairs else None


def _estimate(sheet: McatSheet, t_s: float) -> SpeedEstimate:
    """The tracking observer; its speed is the output of its PI controller."""
    k_p, k_i, full = sheet.shifted("M1_TO_KP"), sheet.shifted("M1_TO_KI"), sheet.full_speed
    if not k_p or not k_i or not full:
        return SpeedEstimate("ideal", t_s)
    return SpeedEstimate(
        "pll",
        t_s,
        kp=k_p * full,
        ki=k_i * full / t_s,
        filter_time=_filter_time(sheet, "M1_TO_SPEED_IIR", t_s),
        whole=True,
    )


def _filter_time(sheet: McatSheet, name: str, period: float) -> float:
    """Time constant in s of a bilinear filter that runs with a period."""
    b_0 = sheet.constant(f"{name}_B0")
    if not b_0:
        return 0.0
    b_0 *= 2.0 if sheet.edition.fixed else 1.0
    return max(0.0, period * (1.0 - b_0) / (2.0 * b_0))


def _observer(sheet: McatSheet) -> FluxObserver | None:
    """The observer of the back-EMF in estimated dq: a PI controller around L s + R."""
    k_p, k_i = sheet.constant("M1_BEMF_DQ_KP_GAIN"), sheet.constant("M1_BEMF_DQ_KI_GAIN")
    drive, t_s = sheet.drive(), sheet.t_s
    if not k_p or not k_i or not drive.l_d or drive.r_s is None or not t_s:
        return None
    scale = _emf_scale(sheet)
    half = 0.5 * (k_p * scale + drive.r_s) / drive.l_d
    inside = half * half - k_i * scale / t_s / drive.l_d
    rate = half - math.sqrt(inside) if inside > 0.0 else half
    return FluxObserver("back-EMF observer in estimated dq with tracking of the angle", rate)


def _emf_scale(sheet: McatSheet) -> float:
    """Volts of back-EMF per ampere of the scales: 1 of a float build."""
    if not sheet.edition.fixed:
        return 1.0
    full = sheet.number("M1_E_MAX") or sheet.number("parametersEmax")
    return (full or 1.0) / (sheet.amperes or 1.0)


NXP = FirmwareMethod(
    "nxp", FLOAT_2025.version, "axes", configure, profile, shortfalls, needs=(MAX_SPEED,)
)
