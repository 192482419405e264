"""Infineon's motor-ctrl-lib: its parameters for a design, and the loops that it then runs."""

from __future__ import annotations

import math

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod, needed
from dqforge.optimizer.firmware.infineon_format import (
    FIRMWARE,
    KEYS,
    TABLE,
    TABLE_KEYS,
    TABLE_POINTS,
    VERSION,
    configuration,
    filter_time,
    flux_table,
    kept,
    number,
    shortfalls,
)

_HOME = "Infineon/REF_MTR_48V30A_GaN motor-ctrl-lib 4.5 OperationalCode/"

SOURCES = (
    _HOME + "ParamsDefault.c PARAMS_DEFAULT_InitAutoCalc: gains of currents, speed and PLL",
    _HOME + "General.c PI_Run: integral first, its excess taken back whole; LUT1DInterp",
    _HOME + "CurrentCtrl.c: each axis limited to vdc_nom/sqrt(3) with its feedforward",
    _HOME + "StateMachine.c SpeedCLISR0: speed and current controllers in every control step",
    _HOME + "PLL.c, Observer.c: speed = integral + kp error, of the error one step before",
    _HOME + "PhaseAdvance.c: currents of most torque per ampere, closed form",
    _HOME + "CtrlFilts.c, Biquad.c: filter on the speed, backward Euler",
)

# Rate in rad/s of the phase-locked loop where nothing else is asked for.
PLL_RATE = 2.0 * math.pi * 500.0
_LARGEST_PLL_STEP = 0.2  # Largest rate of the phase-locked loop times its period.
_WEAKENING_SHARE = 0.2


def configure(asked: Asked) -> Configuration:
    """The configuration for a design.

    Raises:
        InputError: The design says too little of its machine, or has no magnet; with the key.
    """
    values = _machine(asked.drive)
    values |= _loops(asked)
    sensing = asked.design.inverter.current_sensing
    if sensing is not None:
        values["params.sys.analog.shunt.res"] = kept(sensing.shunt, "inverter.current_sensing")
    values |= _table(asked, values)
    own = {name: values[name] for name in (*KEYS, *TABLE_KEYS, TABLE) if name in values}
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that the library runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    t_s = found.drive.t_s
    if found.current_d is None or found.current_q is None or t_s is None:
        missing = "sys.samp.fs0" if t_s is None else "ctrl.curr.bw with r, ld and lq"
        raise InputError(
            f"the parameters of motor-ctrl-lib have no {missing}, which its current loops need; "
            f"name the whole file"
        )
    fed = bool(number(found.own, "ctrl.curr.ff_coef"))
    return LoopProfile(
        firmware="infineon",
        version=found.version,
        current=CurrentLoops(
            d=_current(found, found.current_d, t_s),
            q=_current(found, found.current_q, t_s),
            delay=1.0,
            cross=fed,
            back_emf=fed,
            order="axes",
        ),
        speed=_speed_loop(found, t_s),
        observer=FluxObserver("the filter of the stator flux linkage"),
        reference="mtpa-linear" if found.drive.l_d != found.drive.l_q else "id-zero",
        sources=SOURCES,
    )


def _needed(value: float | None, key: str, what: str, otherwise: str = "give it") -> float:
    return needed(value, key, FIRMWARE, what, otherwise)


def _magnets(drive: DriveValues) -> float:
    without = "a machine without any needs another firmware"
    return _needed(drive.psi_pm, "machine.magnet_flux", "the flux linkage of magnets", without)


def _machine(drive: DriveValues) -> dict[str, OwnValue]:
    if not drive.pole_pairs:
        raise InputError(
            "machine: Infineon's library needs the number of poles; give poles or pole_pairs"
        )
    r_s = _needed(drive.r_s, "machine.resistance", "a resistance")
    psi = _magnets(drive)
    i_max = _needed(drive.i_max, "machine.max_current", "a largest current")
    v_dc = _needed(drive.v_dc, "inverter.v_dc", "the voltage of the dc link")
    f_sw = _needed(drive.f_sw, "inverter.switching_frequency", "a PWM frequency")
    available = linear_voltage(v_dc)
    most = drive.omega_m_max * drive.pole_pairs if drive.omega_m_max else available / psi
    rated = min(most, available / psi)
    ratio = 1 if drive.t_s is None else max(round(drive.t_s * f_sw), 1)
    rate = f_sw / ratio
    keys = {
        "machine.resistance": {
            "motor.r": r_s,
            "ctrl.align.voltage": 0.5 * r_s * i_max,
        },
        "machine.inductance_q": {
            "motor.lq": _needed(drive.l_q, "machine.inductance_q", "inductances"),
            "motor.ld": _needed(drive.l_d, "machine.inductance_d", "inductances"),
        },
        "machine.magnet_flux": {"motor.lam": psi},
        "machine.max_current": _of_current(i_max, rate),
        "machine.max_speed": _of_speed(most, rated, drive.pole_pairs),
        "inverter.v_dc": {"motor.v_nom": available, "sys.vdc_nom": v_dc},
        "inverter.switching_frequency": {
            "sys.samp.fs0": rate,
            "sys.analog.filt.w0_i_ph": rate,
            "sys.analog.filt.w0_v_ph": rate,
        },
    }
    values: dict[str, OwnValue] = {
        f"params.{name}": kept(value, key)
        for key, named in keys.items()
        for name, value in named.items()
    }
    values["params.motor.P"] = 2 * drive.pole_pairs
    values["params.sys.samp.fpwm_fs0_ratio"] = ratio
    values["params.mech.viscous"] = kept(drive.viscous or 0.0, "machine.friction")
    values["params.mech.friction"] = 0.0
    if drive.inertia:
        values["params.mech.inertia"] = kept(drive.inertia, "machine.inertia")
    return values


def _of_current(i_max: float, rate: float) -> dict[str, float]:
    """Members that follow from the largest current, and from the rate of the control in Hz."""
    return {
        "motor.i_peak": i_max,
        "motor.i_cont": i_max,
        "motor.id_max": i_max,
        "sys.cmd.i_max": i_max,
        "sys.rate_lim.i_cmd": i_max * rate,
        "ctrl.curr.i_cmd_thresh": 0.2 * i_max,
        "ctrl.curr.i_cmd_hyst": 0.02 * i_max,
        "ctrl.six_pulse_inj.i_peak": 0.5 * i_max,
        "ctrl.high_freq_inj.i_qd_r_peak.d": 0.2 * i_max,
    }


def _of_speed(most: float, rated: float, pole_pairs: int) -> dict[str, float]:
    """Members that follow from the largest and the rated electrical speed in rad/s."""
    return {
        "motor.w_nom.elec": rated,
        "motor.w_max.elec": most,
        "sys.cmd.w_max.mech": most / pole_pairs,
        "sys.rate_lim.w_cmd.elec": most,
        "obs.pll.w_max.elec": 1.5 * most,
        "obs.w_thresh.elec": 0.1 * rated,
        "obs.w_hyst.elec": 0.01 * rated,
        "ctrl.volt.w_thresh.elec": 0.01 * rated,
        "ctrl.volt.w_hyst.elec": 0.001 * rated,
    }


def _loops(asked: Asked) -> dict[str, OwnValue]:
    drive = asked.drive
    assert drive.l_q is not None
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    bandwidth = asked.current_q.kp / drive.l_q
    named = {
        "ctrl.curr.bw": bandwidth,
        "ctrl.curr.ff_coef": 1.0,
        "ctrl.flux_weaken.bw": _WEAKENING_SHARE * bandwidth,
        "ctrl.curr.kp.q": asked.current_q.kp,
        "ctrl.curr.kp.d": asked.current_d.kp,
        "ctrl.curr.ki.q": asked.current_q.ki,
        "ctrl.curr.ki.d": asked.current_d.ki,
    }
    values: dict[str, OwnValue] = {
        f"params.{name}": kept(value, "control.current_loop") for name, value in named.items()
    }
    values["params.filt.spd_ar_en"] = "Dis"
    values |= _pll(asked, drive.psi_pm)
    if asked.speed is not None:
        values |= _speed(asked.speed, drive, drive.pole_pairs, drive.psi_pm)
    return values


def _pll(asked: Asked, psi_pm: float) -> dict[str, OwnValue]:
    """The loop s^2 + w0 s + w0^2/2, or what is asked for."""
    rate = PLL_RATE
    if asked.drive.t_s:
        rate = min(rate, _LARGEST_PLL_STEP / asked.drive.t_s)
    wished = asked.pll or PiGains(rate, 0.5 * rate * rate)
    key = "control.firmware"
    return {
        "params.obs.pll.w0": kept(wished.kp, key),
        "params.obs.pll.kp": kept(wished.kp / psi_pm, key),
        "params.obs.pll.ki": kept(wished.ki / psi_pm, key),
    }


def _speed(
    wished: PiGains, drive: DriveValues, pole_pairs: int, psi_pm: float
) -> dict[str, OwnValue]:
    key = "control.speed_loop"
    inertia = _needed(drive.inertia, "machine.inertia", "an inertia for its speed controller")
    constant = torque_per_ampere(pole_pairs, psi_pm)
    return {
        "params.ctrl.speed.bw": kept(wished.kp * constant / inertia, key),
        "params.ctrl.speed.kp": kept(wished.kp / pole_pairs, key),
        "params.ctrl.speed.ki": kept(wished.ki / pole_pairs, key),
    }


def _table(asked: Asked, values: dict[str, OwnValue]) -> dict[str, OwnValue]:
    """Largest torque, and flux linkage over torque."""
    table = flux_table(asked.design)
    step = table.most / (TABLE_POINTS - 1)
    key = "machine.max_current"
    held: dict[str, OwnValue] = {
        "params.motor.T_max": table.most,
        "params.motor.mtpa_lut.x_min": 0.0,
        "params.motor.mtpa_lut.x_max": table.most,
        "params.motor.mtpa_lut.x_step": kept(step, key),
        "params.motor.mtpa_lut.x_step_inv": kept(1.0 / step, key),
        TABLE: ", ".join(f"{value:.7g}" for value in table.flux),
    }
    return values | held


def _current(found: Configuration, gains: PiGains, t_s: float) -> PiController:
    corner = number(found.own, "sys.analog.filt.w0_i_ph")
    lag = 0.0 if not corner else max(1.0 / corner - t_s, 0.0)
    return PiController(
        gains.kp,
        gains.ki,
        t_s,
        rule="integral-first",
        anti_windup="back-calculation",
        filter_time=lag,
        tracking=1.0 / t_s,
    )


def _speed_loop(found: Configuration, t_s: float) -> SpeedController | None:
    own, drive = found.own, found.drive
    if found.speed is None:
        return None
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        t_s,
        rule="integral-first",
        anti_windup="back-calculation",
        limit=drive.i_max,
        filter_time=filter_time(own),
        tracking=1.0 / t_s,
    )
    slope = number(own, "sys.rate_lim.w_cmd.elec")
    ramp = slope / drive.pole_pairs if slope and drive.pole_pairs else None
    return SpeedController(pi, _estimate(found, t_s), ramp)


def _estimate(found: Configuration, t_s: float) -> SpeedEstimate:
    """The phase-locked loop, whose whole output is the speed; ideal where its rate is not said."""
    own, psi = found.own, found.drive.psi_pm
    kp, ki = number(own, "obs.pll.kp"), number(own, "obs.pll.ki")
    rate = number(own, "obs.pll.w0")
    if kp is not None and ki is not None and psi:
        return SpeedEstimate("pll", t_s, kp=kp * psi, ki=ki * psi, whole=True)
    if rate:
        return SpeedEstimate("pll", t_s, kp=rate, ki=0.5 * rate * rate, whole=True)
    return SpeedEstimate("ideal", t_s)


INFINEON = FirmwareMethod("infineon", VERSION, "axes", configure, profile, shortfalls)
