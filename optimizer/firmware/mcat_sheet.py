"""What one file of MCAT amounts to: machine, gains and limits in SI units.

Inputs stand by MCAT's keys, constants by their macros, all in one mapping. A constant of a
fixed-point build counts as the integer that the compiler makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, replace

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware import firmware_method
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.mcat_numbers import (
    EDITIONS,
    FIXED_2019,
    FIXED_2022,
    FLOAT_2019,
    FLOAT_2022,
    FLOAT_2025,
    OLD_PLACES,
    PROJECT_INPUTS,
    PROJECT_MACROS,
    SPEED_I,
    SPEED_P,
    Edition,
    constants,
    counts,
    half_step,
    held,
    numbers,
    printed,
    torque_constant,
)

TURN = 2.0 * math.pi

ROOT_3 = math.sqrt(3.0)


def kind_of(macro: str, edition: Edition) -> str:
    """How a constant is written: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``."""
    name = macro.removeprefix("M1_")
    if name in ("MOTOR_PP", "E_BLOCK_PER") or name.endswith(("_DURATION", "_SHIFT")):
        return "plain"
    if name == "SCALAR_INTEG_GAIN":
        return "ACC32"
    if name == "MERG_COEFF":
        return "FRAC16"
    if not edition.fixed or name in ("N_MAX", "FREQ_MAX", "I_MAX", "U_MAX", "E_MAX", "U_DCB_MAX"):
        return "float"
    return _fixed_kind(name)


def _fixed_kind(name: str) -> str:
    if "_IIR_" in name or "_RAMP_" in name:
        return "FRAC32"
    if name.startswith(("TO_", "SCALAR_VHZ")):
        return "FRAC16"
    if name.endswith(("_KP_GAIN", "_KI_GAIN", "_PROP_GAIN", "_INTEG_GAIN")):
        return "ACC32"
    return "ACC32" if name in ("I_SCALE", "U_SCALE", "E_SCALE", "WI_SCALE") else "FRAC16"


@dataclass(frozen=True, slots=True)
class McatSheet:
    """Inputs and constants of one motor.

    Args:
        edition: The age of the format, and its arithmetic.
        own: Inputs by MCAT's keys, constants by their macros (as of the first motor).
    """

    edition: Edition
    own: Mapping[str, OwnValue] = field(default_factory=dict)

    def number(self, key: str) -> float | None:
        """A value as it stands there, None where it is missing or no number."""
        return firmware_method.number(self.own, key)

    def constant(self, macro: str) -> float | None:
        """A constant as the firmware computes with it: in fixed point what its integer holds."""
        value = self.number(macro)
        kind = kind_of(macro, self.edition)
        if value is None or kind in ("plain", "float"):
            return value
        return held(value, kind)

    def shifted(self, name: str) -> float | None:
        """A constant with the power of two that stands beside it in fixed point."""
        value, shift = self.constant(f"{name}_GAIN"), self.number(f"{name}_SHIFT")
        return value if value is None or shift is None else math.ldexp(value, int(shift))

    @property
    def pole_pairs(self) -> int | None:
        """Number of pole pairs."""
        value = self.number("M1_MOTOR_PP") or self.number("parametersPP")
        return None if value is None else round(value)

    @property
    def amperes(self) -> float | None:
        """Scale of the currents in A: 1 of a float build."""
        return (
            (self.number("M1_I_MAX") or self.number("parametersImax"))
            if (self.edition.fixed)
            else 1.0
        )

    @property
    def volts(self) -> float | None:
        """Scale of the phase voltages in V: 1 of a float build, else U_DCB_MAX/sqrt(3)."""
        if not self.edition.fixed:
            return 1.0
        full = self.number("M1_U_DCB_MAX") or self.number("parametersUdcbMax")
        return None if full is None else full / ROOT_3

    @property
    def full_speed(self) -> float | None:
        """Scale of the electrical speeds in rad/s: 1 of a float build."""
        if not self.edition.fixed:
            return 1.0
        rpm = self.number("M1_N_MAX") or self.number("parametersNmax")
        pairs = self.pole_pairs
        return None if rpm is None or pairs is None else TURN * pairs * rpm / 60.0

    @property
    def t_s(self) -> float | None:
        """Period of the current loop in s, from the tracking observer where no input says it."""
        given = self.number("currentLoopSampleTime")
        theta, full = self.shifted("M1_TO_THETA"), self.full_speed
        if given is not None or theta is None or not full:
            return given
        return math.pi * theta / full

    @property
    def t_speed(self) -> float | None:
        """Period of the speed loop in s; without an input from both ramps, which have one slope.

        The files of 2018 print the same number for both: they do not say.
        """
        given = self.number("speedLoopSampleTime")
        fast, slow = self.constant("M1_SCALAR_RAMP_UP"), self.constant("M1_SPEED_RAMP_UP")
        if given is not None or not fast or not slow or self.t_s is None or fast == slow:
            return given
        return self.t_s * slow / fast / (1.0 if self.edition.fixed else TURN)

    def current(self, axis: str) -> PiGains | None:
        """Gains of a current controller (``D`` or ``Q``) in V/A and V/(A s)."""
        k_p, k_i = self.constant(f"M1_{axis}_KP_GAIN"), self.constant(f"M1_{axis}_KI_GAIN")
        t_s, volts, amperes = self.t_s, self.volts, self.amperes
        if k_p is None or k_i is None or not t_s or not volts or not amperes:
            return None
        scale = volts / amperes
        return PiGains(k_p * scale, k_i * scale / (self.edition.current_share * t_s))

    def speed(self) -> PiGains | None:
        """Gains of the speed controller in A s/rad and A/rad, per mechanical speed."""
        k_p, k_i = self.constant(SPEED_P), self.constant(SPEED_I)
        amperes, full, pairs = self.amperes, self.full_speed, self.pole_pairs
        if k_p is None or k_i is None or not self.t_speed or not amperes or not full or not pairs:
            return None
        scale = amperes * pairs / full
        return PiGains(k_p * scale, k_i * scale / (self.edition.speed_share * self.t_speed))

    def meant(self, macro: str) -> bool:
        """Whether a constant is what MCAT makes of the inputs beside it, which say it unrounded."""
        made = constants(self.edition, self.own).get(macro)
        return made is not None and made == self.number(macro)

    def current_limit(self) -> float | None:
        """Largest q current that the speed controller asks for, in A."""
        if self.meant("M1_SPEED_LOOP_HIGH_LIMIT"):
            return self.number("speedLoopUpperLimit")
        value, amperes = self.constant("M1_SPEED_LOOP_HIGH_LIMIT"), self.amperes
        return None if value is None or amperes is None else value * amperes

    def torque(self) -> float | None:
        """Torque constant in N m/A (peak of phase) that the rule of the speed loop takes."""
        return torque_constant(self.edition, numbers(self.edition, self.own))

    def psi_pm(self) -> float | None:
        """Flux linkage in Wb that this torque constant is that of."""
        torque, pairs = self.torque(), self.pole_pairs
        return None if torque is None or not pairs else torque / (1.5 * pairs)

    def largest_speed(self) -> float | None:
        """Nominal speed in rad/s (mechanical), beyond which no speed is asked for."""
        rpm = self.number("parametersNnom") if self.meant("M1_N_NOM") else None
        if rpm is not None:
            return TURN * rpm / 60.0
        value, full, pairs = self.constant("M1_N_NOM"), self.full_speed, self.pole_pairs
        return None if value is None or full is None or not pairs else value * full / pairs

    def link_voltage(self) -> float | None:
        """DC-link voltage in V whose linear range ends at the nominal phase voltage; None where
        the firmware takes this voltage for a fault.
        """
        phase = self.number("parametersUphNom")
        if phase is None:
            return None
        lowest = self.number("parametersUdcbUnder") or -math.inf
        largest = self.number("parametersUdcbOver") or math.inf
        return ROOT_3 * phase if lowest <= ROOT_3 * phase <= largest else None

    def drive(self) -> DriveValues:
        """Machine and timing as the file tells them; without inputs what its constants imply."""
        implied = self.implied()
        return DriveValues(
            pole_pairs=self.pole_pairs,
            r_s=_first(self.number("parametersRs"), implied.get("r_s")),
            l_d=_first(self.number("parametersLd"), implied.get("l_d")),
            l_q=_first(self.number("parametersLq"), implied.get("l_q")),
            psi_pm=self.psi_pm(),
            inertia=self.number("parametersJ"),
            i_max=self.current_limit(),
            omega_m_max=self.largest_speed(),
            v_dc=self.link_voltage(),
            t_s=self.t_s,
            t_speed=self.t_speed,
        )

    def implied(self) -> dict[str, float]:
        """Resistance in Ohm and inductances in H that the constants of the observer are made of."""
        part, rate = self.number("M1_I_SCALE"), self.number("M1_U_SCALE")
        cross, t_s, full = self.number("M1_WI_SCALE"), self.t_s, self.full_speed
        if not part or not rate or not cross or not t_s or not full:
            return {}
        if not self.volts or not self.amperes:
            return {}
        rate *= self.amperes / self.volts
        return {
            "r_s": (1.0 - part) / rate,
            "l_d": part * t_s / rate,
            "l_q": cross / (full * rate),
        }

    def configuration(
        self,
        name: str,
        origins: Mapping[str, Origin],
        conventions: tuple[str, ...],
        contradictions: tuple[str, ...],
    ) -> Configuration:
        """All of it as a configuration."""
        return Configuration(
            firmware="nxp",
            version=self.edition.version,
            name=name,
            drive=self.drive(),
            current_d=self.current("D"),
            current_q=self.current("Q"),
            speed=self.speed(),
            own=dict(self.own),
            origins=dict(origins),
            conventions=conventions,
            contradictions=contradictions,
        )


def _first(given: float | None, implied: float | None) -> float | None:
    return implied if given is None else given


# What in a file of MCAT does not fit together, and how its numbers are to be understood.

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


# A file of MCAT with all that it amounts to, whichever way it came about.

_INTEGRALS = ("M1_D_KI_GAIN", "M1_Q_KI_GAIN")


@dataclass(frozen=True, slots=True)
class McatFile:
    """One file.

    Args:
        name: Of the motor.
        edition: The age of the format, and its arithmetic.
        own: Inputs by MCAT's keys and constants by their macros.
        origins: Where they stand in a file that was read.
    """

    name: str
    edition: Edition
    own: Mapping[str, OwnValue]
    origins: Mapping[str, Origin] = field(default_factory=dict)

    @classmethod
    def read(
        cls,
        name: str,
        own: Mapping[str, OwnValue],
        origins: Mapping[str, Origin],
        *,
        fixed: bool,
        commented: bool,
    ) -> McatFile:
        """A file whose age is to be found from what stands in it.

        Args:
            name: Of the motor.
            own, origins: Inputs and constants, and where they stand.
            fixed: Whether constants stand in fractions.
            commented: Whether inputs stand in line comments, or numbers have more than six digits.
        """
        if fixed:
            edition = FIXED_2019 if commented else FIXED_2022
        elif commented:
            edition = FLOAT_2019
        else:
            edition = _float_edition(own)
        return cls(name, edition, own, origins)

    @classmethod
    def of(cls, found: Configuration) -> McatFile:
        """That of a configuration."""
        return cls(found.name, EDITIONS[found.version], found.own, found.origins)

    def configuration(self) -> Configuration:
        """What it amounts to."""
        sheet = self.sheet
        return sheet.configuration(
            self.name, self.origins, conventions(sheet), contradictions(sheet)
        )

    @property
    def sheet(self) -> McatSheet:
        """Its numbers."""
        return McatSheet(self.edition, self.own)

    def kind(self, macro: str) -> str:
        """How a constant is written: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``."""
        return kind_of(macro, self.edition)

    def in_edition(self, version: str) -> McatFile:
        """The same loops in the format of another age of the same arithmetic.

        The speed filter keeps its cut-off as the firmware runs it: with the period of the speed
        loop, whatever MCAT of that age makes of it.

        Args:
            version: Name of the edition.
        """
        edition = EDITIONS[version]
        if edition == self.edition:
            return self
        inputs = {key: value for key, value in self.own.items() if not key.startswith("M1_")}
        inputs |= self._converted(edition)
        own: dict[str, OwnValue] = {**inputs, **constants(edition, inputs)}
        ratios = dict.fromkeys(_INTEGRALS, edition.current_share / self.edition.current_share)
        ratios[SPEED_I] = edition.speed_share / self.edition.speed_share
        for name in ("M1_D_KP_GAIN", "M1_Q_KP_GAIN", "M1_SPEED_PI_PROP_GAIN", *ratios):
            value = self.sheet.number(name)
            if value is not None:
                scaled = value * ratios.get(name, 1.0)
                own[name] = scaled if edition.commented else printed(scaled)
        return McatFile(self.name, edition, own, self.origins)

    def in_project(self, theirs: McatFile) -> McatFile:
        """The same loops on the board of another file: with its scales, thresholds and ramps.

        A float build alone: in fixed point the gains count in these scales.

        Args:
            theirs: The file of the project, of the same age.
        """
        if self.edition.fixed:
            return self
        own = dict(self.own)
        one, other = self.sheet, theirs.sheet
        outgrown = _outgrown(one, other)
        own |= {
            key: theirs.own[key]
            for key in PROJECT_INPUTS
            if key in theirs.own and not key.startswith(outgrown)
        }
        made: dict[str, OwnValue] = {**constants(self.edition, own)}
        if (one.t_s, one.t_speed, one.pole_pairs) == (other.t_s, other.t_speed, other.pole_pairs):
            made |= theirs.own
        own |= {
            macro: made[macro]
            for macro in PROJECT_MACROS
            if macro in made and not macro.startswith(outgrown)
        }
        return McatFile(self.name, self.edition, own, self.origins)

    def _converted(self, edition: Edition) -> dict[str, OwnValue]:
        """Inputs that mean something else in the other age."""
        sheet, changed = self.sheet, dict[str, OwnValue]()
        torque = sheet.torque()
        if torque is not None and not edition.fixed:
            before = edition.current_share == 1.0
            changed["parametersKe"] = torque / math.sqrt(3.0) if before else torque
        k_p, k_i = sheet.number("M1_SPEED_PI_PROP_GAIN"), sheet.number(SPEED_I)
        if not edition.fixed and k_p is not None and k_i is not None:
            ratio = edition.speed_share / self.edition.speed_share
            changed |= {
                "speedLoopManualConstantTunning": True,
                "speedLoopSLKp": k_p,
                "speedLoopSLKi": k_i * ratio,
            }
        cutoff, t_s, slow = sheet.number("speedLoopCutOffFreq"), sheet.t_s, sheet.t_speed
        if cutoff is not None and t_s and slow and not edition.fixed:
            fast = edition.current_share == 1.0
            was_fast = self.edition.current_share == 1.0
            changed["speedLoopCutOffFreq"] = (
                cutoff * (slow / t_s if fast else 1.0) / (slow / t_s if was_fast else 1.0)
            )
        return changed


def _outgrown(ours: McatSheet, theirs: McatSheet) -> tuple[str, ...]:
    """Starts of the names of thresholds at which the design's link voltage or its largest speed
    would be a fault.
    """
    names: tuple[str, ...] = ()
    voltage, speed = ours.link_voltage(), ours.largest_speed()
    lowest = theirs.number("parametersUdcbUnder") or theirs.number("M1_U_DCB_UNDERVOLTAGE")
    largest = theirs.number("parametersUdcbOver") or theirs.number("M1_U_DCB_OVERVOLTAGE")
    if voltage is not None and not (lowest or 0.0) <= voltage <= (largest or math.inf):
        names += ("parametersUdcbTrip", "parametersUdcbUnder", "parametersUdcbOver")
        names += ("M1_U_DCB_TRIP", "M1_U_DCB_UNDER", "M1_U_DCB_OVER")
    fastest = theirs.constant("M1_N_OVERSPEED")
    pairs = ours.pole_pairs or 1
    if speed is not None and fastest is not None and pairs * speed > fastest:
        names += ("parametersN", "M1_N_", "M1_FREQ_MAX")
    return names


def _float_edition(own: Mapping[str, OwnValue]) -> Edition:
    """By the integral gains where their inputs stand there, else by what only newer files have."""
    errors = {
        edition.version: _misfit(edition, own)
        for edition in (FLOAT_2025, FLOAT_2022)
        if _misfit(edition, own) is not None
    }
    if len(errors) > 1 and errors[FLOAT_2025.version] != errors[FLOAT_2022.version]:
        return EDITIONS[min(errors, key=lambda version: errors[version] or 0.0)]
    newer = "M1_Q_IIR_ZC_B0" in own or ("parametersKt" in own and "parametersKe" not in own)
    return FLOAT_2025 if newer else FLOAT_2022


def _misfit(edition: Edition, own: Mapping[str, OwnValue]) -> float | None:
    made = constants(edition, own)
    found = [
        abs(math.log(float(value) / made[name]))
        for name in _INTEGRALS
        if (value := own.get(name)) and not isinstance(value, str) and made.get(name, 0.0) > 0.0
        if float(value) > 0.0
    ]
    return min(found) if found else None
