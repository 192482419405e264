"""The loops that ST's MCSDK runs with a configuration."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, OwnValue, PiGains
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.profile import (
    CurrentLoops,
    FluxObserver,
    LimitOrder,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.st_format.st_configuration import amperes
from dqforge.optimizer.firmware.st_format.st_mtpa import SEGMENTS, table_currents
from dqforge.optimizer.firmware.st_format.st_observer import (
    low_speed,
    observed_machine,
    placed_poles,
    tracking,
)
from dqforge.optimizer.firmware.st_format.st_scales import FULL, current_scale, integers

SOURCES = (
    "MCSDK 5.4.3 and 6.4 mc_tasks: PI of q, of d, circle limitation, inverse Park",
    "MCSDK pwm_curr_fdbk drivers: sampled round the crest, loaded with the next update",
    "MCSDK pid_regulator: the integral first, held to 32767 counts; its discharge is 1/divider",
    "MCSDK circle_limitation: version 5 along the direction, version 6 q after d, d up to 95 %",
    "MCSDK pwm_curr_fdbk: 32768 counts of voltage are v_dc/sqrt(3)",
    "MCSDK sto_pll_speed_pos_fdbk: observer, PI as phase-locked loop, its output averaged",
    "MCSDK speed_torq_ctrl: PI on tenths of a hertz, held to IQMAX",
    "MCSDK parameters_conversion.h: C1 to C5, scales of current, voltage and back-EMF",
)


def profile(found: Configuration) -> LoopProfile:
    """The loops that the MCSDK runs with a configuration.

    Raises:
        InputError: It says too little of the current controllers.
    """
    own, drive = found.own, found.drive
    if found.current_q is None or drive.t_s is None or drive.v_dc is None:
        raise InputError(
            "the configuration of the MCSDK says too little of its current loops: they need "
            "drive_parameters.h, and of power_stage_parameters.h RSHUNT, AMPLIFICATION_GAIN and "
            "NOMINAL_BUS_VOLTAGE_V"
        )
    table = _table_points(own)
    return LoopProfile(
        firmware="st",
        version=found.version,
        current=_current(found, found.current_q, drive.t_s, drive.v_dc),
        speed=_speed(found),
        observer=_flux_observer(own),
        reference="id-zero" if not table else "table",
        sources=SOURCES,
        table=table,
    )


def _table_points(own: Mapping[str, OwnValue]) -> tuple[tuple[float, float, float], ...]:
    """Ends of the segments as (command, i_d, i_q) in A."""
    full, top = current_scale(own), amperes(own, "IQMAX_A")
    width, slopes, offsets = (
        number(own, "SEGDIV"),
        integers(own.get("ANGC")),
        integers(own.get("OFST")),
    )
    if full is None or not top or not width or slopes is None or offsets is None:
        return ()
    if len(slopes) != SEGMENTS or len(offsets) != SEGMENTS:
        return ()
    edges = np.arange(1, SEGMENTS) * int(width)
    last = max(1, round(top * FULL / full))
    counts = np.unique([0, *edges[edges < last], last])
    i_d = table_currents(int(width), slopes, offsets, counts) * full / FULL
    i_q = counts * full / FULL
    return tuple(zip(i_q.tolist(), i_d.tolist(), i_q.tolist(), strict=True))


def _current(found: Configuration, q: PiGains, t_s: float, v_dc: float) -> CurrentLoops:
    d, limit = found.current_d or q, v_dc / math.sqrt(3.0)
    forward = number(found.own, "CONSTANT2_QD") is not None
    order: LimitOrder = "vector" if found.version == "5" else "d-first"
    return CurrentLoops(
        PiController(d.kp, d.ki, t_s, "integral-first", "clamp", limit),
        PiController(q.kp, q.ki, t_s, "integral-first", "clamp", limit),
        delay=1.0,
        cross=forward,
        back_emf=forward,
        order=order,
        angle_advance=number(found.own, "REV_PARK_ANGLE_COMPENSATION_FACTOR") or 0.0,
    )


def _speed(found: Configuration) -> SpeedController | None:
    gains, period = found.speed, found.drive.t_speed
    if gains is None or period is None:
        return None
    limit = amperes(found.own, "IQMAX_A") or found.drive.i_max
    controller = PiController(gains.kp, gains.ki, period, "integral-first", "clamp", limit)
    return SpeedController(controller, _estimate(found, period))


def _estimate(found: Configuration, period: float) -> SpeedEstimate:
    own, t_s, low = found.own, found.drive.t_s or period, low_speed(found.own)
    loop = None if low is None else tracking(own, low)
    if loop is not None:
        averaged = int(number(own, "STO_FIFO_DEPTH_UNIT") or 64)
        return SpeedEstimate("pll", t_s, loop.kp, loop.ki, averaged=averaged, whole=True)
    depth = number(own, "ENC_AVERAGING_FIFO_DEPTH")
    if depth:
        return SpeedEstimate("difference", period, samples=int(depth))
    return SpeedEstimate("ideal", t_s)


def _flux_observer(own: Mapping[str, OwnValue]) -> FluxObserver | None:
    machine, f1 = observed_machine(own) or observed_machine(own, 1.0), number(own, "F1")
    if machine is None or not f1:
        return None
    slow = max(abs(pole) for pole in placed_poles(own, machine))
    warnings = []
    if slow >= 1.0:
        warnings.append(f"the observer is unstable: a pole at {slow:.4g} per period")
    low = low_speed(own)
    loop = None if low is None else tracking(own, low)
    if loop is not None:
        pole = loop.poles[0]
        warnings.append(
            f"at {loop.speed * 30.0 / math.pi:.4g} rpm the phase-locked loop has poles at "
            f"{pole.real:.4g} {'+-' if pole.imag else 'and'} "
            f"{abs(pole.imag) if pole.imag else loop.poles[1].real:.4g}"
            f"{' j' if pole.imag else ''} rad/s; they are faster at higher speed"
        )
    rate = -math.log(min(max(slow, 1e-12), 1.0)) * machine.rate
    return FluxObserver("state observer with phase-locked loop", rate, tuple(warnings))
