"""A design file from the configuration of a firmware: every value with its source, what the file
does not say as questions, its conventions and contradictions as comments.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Sequence
from decimal import Decimal

from dqforge.machines.files.positioned_yaml import written
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_quantity
from dqforge.optimizer.firmware.configuration import Configuration, PiGains

_LONGEST_NAME = 80
_LONGEST_SOURCE = 300
_PREFIXES = ((6, "M"), (3, "k"), (0, ""), (-3, "m"), (-6, "u"), (-9, "n"))


@dataclass(frozen=True, slots=True)
class _Key:
    """A key of the design: field of the configuration, unit and dimension, whether a design needs
    it, what it is, and an example for questions.
    """

    key: str
    field: str
    unit: str
    dimension: str
    needed: bool
    what: str
    example: str


_MACHINE = (
    _Key("resistance", "r_s", "Ohm", "resistance", True, "the phase resistance", "50 mOhm"),
    _Key("inductance_d", "l_d", "H", "inductance", True, "the d inductance", "100 uH"),
    _Key("inductance_q", "l_q", "H", "inductance", True, "the q inductance", "100 uH"),
    _Key("magnet_flux", "psi_pm", "Wb", "flux", True, "the magnet flux linkage", "6.1 mWb"),
    _Key("max_current", "i_max", "A", "current", True, "the current limit", "40 A"),
    _Key("max_speed", "omega_m_max", "rad/s", "speed", False, "the largest speed", "3000 rpm"),
    _Key("inertia", "inertia", "kg m^2", "inertia", False, "the inertia", "1e-3 kg m^2"),
    _Key("friction", "viscous", "N m s/rad", "friction", False, "the friction", "1e-4 N m s/rad"),
)

_INVERTER = (
    _Key("v_dc", "v_dc", "V", "voltage", True, "the voltage of the dc link", "48 V"),
    _Key("switching_frequency", "f_sw", "Hz", "frequency", True, "the carrier frequency", "20 kHz"),
    _Key("dead_time", "dead_time", "s", "time", False, "the dead time", "500 ns"),
)

_USUAL_REFERENCE = 3.3  # Reference of the converter in V where a file does not say it.

_KINDS = {
    "resistance": "phase",
    "inductance_d": "phase",
    "inductance_q": "phase",
    "magnet_flux": "peak",
    "max_current": "peak",
}

_GAIN_UNITS = {
    "current": (("V/A", "current-gain"), ("V/(A s)", "current-integral-gain")),
    "speed": (("N m s/rad", "speed-gain"), ("N m/rad", "speed-integral-gain")),
}

_JUDGED = "# the file's gains are judged, whatever they keep; 30 deg is usual"


@dataclass(frozen=True, slots=True)
class MadeDesign:
    """A design file that was made.

    Args:
        text: Its text.
        missing: Dotted keys that a design needs and the file does not say, each with an example.
        wanted: The same of keys without which a part of the file is left out.
        origins: By the dotted key, the name of the value in ``Configuration.origins``.
    """

    text: str
    missing: tuple[tuple[str, str], ...]
    wanted: tuple[tuple[str, str], ...]
    origins: dict[str, str]


def design_of(
    found: Configuration,
    sources: Sequence[str],
    *,
    pll: PiGains | None = None,
    prefix: str = "motor",
    given: Collection[str] = (),
) -> MadeDesign:
    """The design file of a configuration.

    Args:
        found: The configuration.
        sources: Names of the files that it was read from.
        pll: Gains of the phase-locked loop that makes the speed, in 1/s and 1/s^2; None without
            one.
        prefix: First part of the names in the C code.
        given: Dotted keys that are set from outside, and not asked for.
    """
    return _Writer(found, sources, set(given)).made(pll, prefix)


class _Writer:
    """Lines of a design file in the course of being written."""

    def __init__(self, found: Configuration, sources: Sequence[str], given: set[str]) -> None:
        self.found, self.sources, self.given = found, sources, given
        self.lines: list[str] = []
        self.missing: list[tuple[str, str]] = []
        self.wanted: list[tuple[str, str]] = []
        self.origins: dict[str, str] = {}

    def made(self, pll: PiGains | None, prefix: str) -> MadeDesign:
        """Write all sections."""
        self._head()
        self._machine()
        self._inverter()
        self._control(pll)
        self.lines += ["", "operation:", "  strategy: id0", "", "export:", f"  prefix: {prefix}"]
        self.lines.append(
            f"  # firmware: [{self.found.firmware}]   # dqforge run then writes its file again"
        )
        text = "\n".join(self.lines) + "\n"
        return MadeDesign(text, tuple(self.missing), tuple(self.wanted), self.origins)

    def _head(self) -> None:
        found = self.found
        files = ", ".join(self.sources)
        self._comment(f"Read from {files}: configuration of {found.firmware} {found.version}.")
        self._comment("Every value says where it stands there; what is missing is marked QUESTION.")
        for sentence in found.conventions:
            self._comment(f"Convention: {sentence}")
        for sentence in found.contradictions:
            self._comment(f"CONTRADICTION: {sentence}")
        name = _plain(found.name or files)[:_LONGEST_NAME]
        self.lines += ["dqforge: 1", f"name: {written(name)}", ""]

    def _comment(self, text: str) -> None:
        self.lines.append(f"# {_plain(text)}")

    def _machine(self) -> None:
        drive = self.found.drive
        self.lines.append("machine:")
        if "machine.pole_pairs" in self.given or "machine.poles" in self.given:
            pass
        elif drive.pole_pairs is None:
            self._question("machine", "pole_pairs", "the number of pole pairs", "7", needed=True)
        else:
            self.lines.append(f"  pole_pairs: {self._entry('pole_pairs', str(drive.pole_pairs))}")
            self.origins["machine.pole_pairs"] = "pole_pairs"
        for key in _MACHINE:
            self._quantity("machine", key)

    def _inverter(self) -> None:
        self.lines += ["", "inverter:", "  topology: three-wire"]
        for key in _INVERTER:
            self._quantity("inverter", key)
        self._sensing()

    def _sensing(self) -> None:
        """The current measurement, where the file says shunt and gain."""
        drive = self.found.drive
        if drive.shunt is None or drive.sense_gain is None:
            return
        reference = drive.sense_reference or _USUAL_REFERENCE
        said = [
            ("shunt", "shunt", exact_text(drive.shunt, "Ohm", "resistance")),
            ("gain", "sense_gain", f"{drive.sense_gain!r}"),
            ("reference", "sense_reference", exact_text(reference, "V", "voltage")),
        ]
        self.lines.append("  current_sensing:")
        for key, field, text in said:
            stated = getattr(drive, field) is not None
            entry = self._entry(field, text) if stated else f"{text}   # the usual one, not said"
            self.lines.append(f"    {key}: {entry}")
            if stated:
                self.origins[f"inverter.current_sensing.{key}"] = field

    def _quantity(self, section: str, key: _Key) -> None:
        """A value of the configuration, or the question for it."""
        path = f"{section}.{key.key}"
        value = getattr(self.found.drive, key.field)
        if path in self.given:
            return
        if value is None:
            if key.key == "inertia" and self.found.speed is not None:
                self._ask(
                    key.key, f"{key.what}, which its speed controller is judged with", key.example
                )
                self.wanted.append((path, key.example))
            else:
                self._question(section, key.key, key.what, self._example(key), needed=key.needed)
            return
        exact = speed_text if key.dimension == "speed" else exact_text
        text = exact(float(value), key.unit, key.dimension)
        self.lines.append(f"  {key.key}: {self._entry(key.field, text, _KINDS.get(key.key))}")
        self.origins[path] = key.field

    def _example(self, key: _Key) -> str:
        """An example that goes with what the file says."""
        t_s = self.found.drive.t_s
        return rate_text(t_s) if key.field == "f_sw" and t_s else key.example

    def _question(self, section: str, key: str, what: str, example: str, *, needed: bool) -> None:
        if f"{section}.{key}" in self.given:
            return
        if not needed:
            self.lines.append(f"  # {key}: {example}   # the file does not say {what}")
            return
        self._ask(key, what, example)
        self.missing.append((f"{section}.{key}", example))

    def _ask(self, key: str, what: str, example: str) -> None:
        self.lines.append(f"  # QUESTION: the file does not say {what}; write it, such as")
        self.lines.append(f"  # {key}: {example}")

    def _entry(self, field: str, text: str, kind: str | None = None) -> str:
        """A value with its kind and its source, in braces."""
        parts = [f"value: {text}"]
        if kind is not None:
            parts.append(f"kind: {kind}")
        parts.append(f"source: {written(self._source(field))}")
        return "{" + ", ".join(parts) + "}"

    def _source(self, field: str) -> str:
        """Where a value stands, as it stands there."""
        origin = self.found.origins.get(field)
        file = self.sources[0] if len(self.sources) == 1 else " or ".join(self.sources)
        if origin is None:
            return _plain(f"{file}: not written there, as {self.found.firmware} runs with it")[
                :_LONGEST_SOURCE
            ]
        place = file if origin.line is None else f"{file}:{origin.line}"
        how = f" ({origin.conversion})" if origin.conversion else ""
        return _plain(f"{place} {origin.key} {origin.text}{how}")[:_LONGEST_SOURCE]

    def _control(self, pll: PiGains | None) -> None:
        found = self.found
        self.lines += ["", "control:"]
        if pll is None:
            self.lines.append(f"  firmware: {found.firmware}   # whose loops are judged")
        else:
            self.lines.append(
                f"  firmware: {{name: {found.firmware}, pll_kp: {pll.kp!r}, pll_ki: {pll.ki!r}}}"
            )
            self.origins |= {f"control.firmware.pll_{gain}": f"pll.{gain}" for gain in ("kp", "ki")}
        t_s = found.drive.t_s
        if t_s is not None and t_s > 0.0:
            text = rate_text(t_s)
            self.lines.append(f"  sampling_frequency: {self._entry('t_s', text)}")
            self.origins["control.sampling_frequency"] = "t_s"
        gains = found.current_q or found.current_d
        if gains is not None:
            self._current(gains)
        if found.speed is not None:
            self._speed(found.speed)

    def _current(self, gains: PiGains) -> None:
        other = self.found.current_d
        name = "current_d" if gains is other else "current_q"
        if other is not None and other != gains:
            self.lines.append(
                f"  # The d axis has other gains: kp {other.kp:.9g} V/A, ki {other.ki:.9g} V/(A s)."
            )
        self.lines += ["  current_loop:", "    method: given"]
        self._gains("control.current_loop", name, gains, _GAIN_UNITS["current"], "    ")
        self.lines.append(f"    min_phase_margin: 1 deg   {_JUDGED}")

    def _gains(
        self,
        section: str,
        name: str,
        gains: PiGains,
        units: Sequence[tuple[str, str]],
        margin: str,
    ) -> None:
        for key, value, (unit, dimension) in zip(
            ("kp", "ki"), (gains.kp, gains.ki), units, strict=True
        ):
            text = exact_text(value, unit, dimension)
            self.lines.append(f"{margin}{key}: {self._entry(f'{name}.{key}', text)}")
            self.origins[f"{section}.{key}"] = f"{name}.{key}"

    def _speed(self, speed: PiGains) -> None:
        """The speed controller; as a comment where the torque per ampere or the inertia is not
        known.
        """
        drive = self.found.drive
        known = drive.pole_pairs is not None and drive.psi_pm is not None and drive.t_s is not None
        inertia = drive.inertia is not None or "machine.inertia" in self.given
        if not known or drive.pole_pairs is None or drive.psi_pm is None or drive.t_s is None:
            self._left_out(speed, "pole pairs, magnet flux and period are not all known")
            return
        per_ampere = 1.5 * drive.pole_pairs * drive.psi_pm
        margin = "  " if inertia else "  # "
        if not inertia:
            self.lines.append("  # With machine.inertia the speed controller can be judged:")
        ratio = max(1, round((drive.t_speed or drive.t_s) / drive.t_s))
        self.lines += [
            f"{margin}speed_loop:",
            f"{margin}  method: given",
            f"{margin}  ratio: {ratio}",
        ]
        gains = PiGains(speed.kp * per_ampere, speed.ki * per_ampere)
        self._gains("control.speed_loop", "speed", gains, _GAIN_UNITS["speed"], f"{margin}  ")
        self.lines.append(f"{margin}  min_phase_margin: 1 deg   {_JUDGED}")

    def _left_out(self, speed: PiGains, why: str) -> None:
        self.lines.append(
            f"  # The speed controller (kp {speed.kp:.9g} A s/rad, ki {speed.ki:.9g} A/rad) is "
            f"left out: {why}."
        )


def _plain(text: str) -> str:
    """A text on one line, of printable characters."""
    return "".join(character if character.isprintable() else " " for character in text).strip()


def exact_text(value: float, unit: str, dimension: str) -> str:
    """A quantity with the prefix that reads best, and nothing of it lost."""
    plain = f"{value!r} {unit}"
    # Only units of one symbol take a prefix that is certainly understood.
    if unit not in {"Ohm", "H", "Wb", "V", "A", "Hz", "s"} or value == 0.0:
        return plain
    decimal = Decimal(repr(value))
    for exponent, prefix in _PREFIXES:
        if decimal.adjusted() >= exponent:
            text = f"{decimal.scaleb(-exponent).normalize():f} {prefix}{unit}"
            return text if _reads_as(text, dimension, value) else plain
    return plain


def speed_text(value: float, unit: str, dimension: str) -> str:
    """A speed in rpm where that is a number of few digits, else as `exact_text`."""
    text = f"{float(f'{value * 30.0 / math.pi:.9g}'):.9g} rpm"
    read = parse_quantity(text, dimension)
    # Equal but for the last bit, in which the order of the products counts.
    same = math.isclose(read, value, rel_tol=4.0 * sys.float_info.epsilon)
    return text if same else exact_text(value, unit, dimension)


def rate_text(t_s: float) -> str:
    """The frequency of a period in s, of few digits where one of few has that very period."""
    short = float(f"{1.0 / t_s:.9g}")
    return exact_text(short if 1.0 / short == t_s else 1.0 / t_s, "Hz", "frequency")


def _reads_as(text: str, dimension: str, value: float) -> bool:
    try:
        return parse_quantity(text, dimension) == value
    except ValueError:
        return False
