"""The members of ``params`` of Infineon's motor-ctrl-lib that a design decides, or that its loops
depend on.

Names and units are those of ``Params.h`` and ``ParamsDefault.c`` of the library's release 4.5
(Infineon/REF_MTR_48V30A_GaN); its text is not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware import own_values
from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.own_values import FLOAT32_DIGITS, float32_value, rounded

FIRMWARE = "Infineon's library"  # Its name in messages.
VERSION = "motor-ctrl-lib 4.5"
TABLE_POINTS = 128  # Points of a table of the library (LUT_1D_WIDTH).
TABLE = "params.motor.mtpa_lut.y"

# A float, a float that is whole, an unsigned integer, an enumerator.
Kind = Literal["real", "poles", "count", "word"]

# Where it is assigned: in every build, in builds with rotor frame orientation only, or there but
# after the library has worked out its gains.
Place = Literal["any", "rotor", "gains"]


@dataclass(frozen=True, slots=True)
class Key:
    """One member: its name, its kind, its unit, what it means, and where it is assigned; ``start``
    marks rules for starting the motor.
    """

    name: str
    kind: Kind
    unit: str
    says: str
    place: Place = "any"
    start: bool = False


# fmt: off
_KEYS = (
    Key("motor.P", "poles", "", "poles: twice the pole pairs"),
    Key("motor.lq", "real", "H", "inductance of a phase, q axis"),
    Key("motor.ld", "real", "H", "inductance of a phase, d axis"),
    Key("motor.lam", "real", "Wb", "flux linkage of the magnets, peak of phase"),
    Key("motor.r", "real", "Ohm", "resistance of a phase"),
    Key("motor.T_max", "real", "N m", "largest torque"),
    Key("motor.i_peak", "real", "A", "largest current, peak of phase"),
    Key("motor.i_cont", "real", "A", "continuous current: the same, as the design has one limit"),
    Key("motor.id_max", "real", "A", "largest current against the magnets: the same"),
    Key("motor.v_nom", "real", "V", "peak phase voltage: that of the dc link over sqrt(3)"),
    Key("motor.w_nom.elec", "real", "rad/s", "speed at which the back-EMF takes it"),
    Key("motor.w_max.elec", "real", "rad/s", "largest electrical speed"),
    Key("sys.samp.fs0", "real", "Hz", "frequency of the control"),
    Key("sys.samp.fpwm_fs0_ratio", "count", "", "PWM periods per control step"),
    Key("sys.analog.filt.w0_i_ph", "real", "rad/s", "filter of the currents: none at fs0"),
    Key("sys.analog.filt.w0_v_ph", "real", "rad/s", "filter of the voltages: the same"),
    Key("sys.analog.shunt.res", "real", "Ohm", "resistance of a shunt"),
    Key("sys.vdc_nom", "real", "V", "voltage of the dc link"),
    Key("sys.cmd.w_max.mech", "real", "rad/s", "full scale of the speed command"),
    Key("sys.cmd.i_max", "real", "A", "full scale of the current command", "rotor"),
    Key("sys.rate_lim.i_cmd", "real", "A/s", "slope of the current: in one step", "rotor"),
    Key("sys.rate_lim.w_cmd.elec", "real", "rad/s^2", "slope of the speed", start=True),
    Key("mech.inertia", "real", "kg m^2", "moment of inertia"),
    Key("mech.viscous", "real", "N m s/rad", "viscous friction"),
    Key("mech.friction", "real", "N m", "dry friction: the design knows none"),
    Key("obs.pll.w0", "real", "rad/s", "phase-locked loop for angle and speed"),
    Key("obs.pll.w_max.elec", "real", "rad/s", "its largest speed: 150 % of the largest"),
    Key("obs.w_thresh.elec", "real", "rad/s", "least of the observer: 10 % of w_nom", start=True),
    Key("obs.w_hyst.elec", "real", "rad/s", "its hysteresis", start=True),
    Key("filt.spd_ar_en", "word", "", "no filter on the speed"),
    Key("ctrl.speed.bw", "real", "rad/s", "bandwidth of the speed controller"),
    Key("ctrl.curr.bw", "real", "rad/s", "bandwidth of the current controllers", "rotor"),
    Key("ctrl.curr.ff_coef", "real", "", "back-EMF and cross terms are fed forward", "rotor"),
    Key("ctrl.curr.i_cmd_thresh", "real", "A", "least: 20 % of i_cont", "rotor", start=True),
    Key("ctrl.curr.i_cmd_hyst", "real", "A", "its hysteresis", "rotor", start=True),
    Key("ctrl.flux_weaken.bw", "real", "rad/s", "field weakening: a fifth of it", "rotor"),
    Key("ctrl.volt.w_thresh.elec", "real", "rad/s", "least speed of V/f: 1 % of w_nom", start=True),
    Key("ctrl.volt.w_hyst.elec", "real", "rad/s", "its hysteresis", start=True),
    Key("ctrl.align.voltage", "real", "V", "voltage that aligns: half of r i_cont", start=True),
    Key("ctrl.six_pulse_inj.i_peak", "real", "A", "pulses that find the rotor: 50 %", start=True),
    Key("ctrl.high_freq_inj.i_qd_r_peak.d", "real", "A", "injected d current: 20 %", start=True),
    Key("obs.pll.kp", "real", "rad/s/Wb", "proportional gain of the loop over lam", "gains"),
    Key("obs.pll.ki", "real", "rad/s^2/Wb", "integral gain of the loop over lam", "gains"),
    Key("ctrl.curr.kp.q", "real", "V/A", "proportional gain, q current", "gains"),
    Key("ctrl.curr.kp.d", "real", "V/A", "proportional gain, d current", "gains"),
    Key("ctrl.curr.ki.q", "real", "V/(A s)", "integral gain, q current", "gains"),
    Key("ctrl.curr.ki.d", "real", "V/(A s)", "integral gain, d current", "gains"),
    Key("ctrl.speed.kp", "real", "A s/rad", "proportional gain, per electrical speed", "gains"),
    Key("ctrl.speed.ki", "real", "A/rad", "integral gain, per electrical speed", "gains"),
)
# fmt: on

# What `configure` writes, by the name of the member, in the order of the file.
KEYS: Mapping[str, Key] = {
    f"params.{key.name}": Key(
        f"params.{key.name}", key.kind, key.unit, key.says, key.place, key.start
    )
    for key in _KEYS
}

TABLE_KEYS: Mapping[str, Key] = {
    f"params.motor.mtpa_lut.{name}": Key(name, "real", unit, says)
    for name, unit, says in (
        ("x_min", "N m", "torque of the first point"),
        ("x_max", "N m", "torque of the last point"),
        ("x_step", "N m", "between two points"),
        ("x_step_inv", "1/(N m)", "one over that"),
    )
}

# Members that are read beside those, as the loops depend on them.
READ_ONLY: Mapping[str, Key] = {
    f"params.filt.spd_ar_w{kind}[{index}]": Key(f"spd_ar_w{kind}", "real", "rad/s", what)
    for kind, what in (("p", "pole"), ("z", "zero"))
    for index in (0, 1)
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, FLOAT32_DIGITS)


def kept(value: float, asked_by: str) -> float:
    """A value as the file holds it; raises InputError, naming the key of the design, where a
    float32 cannot.
    """
    return float32_value(value, asked_by, FIRMWARE)


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A member (``motor.r``) as a number, None without one."""
    return own_values.number(own, f"params.{name}")
