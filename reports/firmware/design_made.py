"""Files of a firmware: which firmware they are of, the configuration in them, whether its loops
settle, and the design that is made of them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.design.catalogue import load_text, overridden, read_override
from dqforge.machines.design.numerical import numerical_errors
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError, NoSolutionError, leading_path
from dqforge.machines.files.positioned_yaml import parse_yaml, written
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import parse_quantity
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues, Origin, PiGains
from dqforge.optimizer.firmware.solve import FirmwareFit, profile_of, solve_firmware
from dqforge.reports.firmware.loop_code import modulation_of
from dqforge.reports.firmware.target import (
    TARGETS,
    Target,
    TextFile,
    Verdict,
    firmware_simulator,
    read_text_file,
    settles,
)

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.reports.simulation.recorded_run import Simulator


Targets = Mapping[Firmware, Target]


def known_files(targets: Targets = TARGETS) -> str:
    """What can be read, in words."""
    return "; ".join(target.title for target in targets.values()) or "none yet"


def recognised(file: TextFile, targets: Targets = TARGETS) -> Target | None:
    """The target whose file it is, None where it is of none."""
    name = Path(file.source).name
    return next((one for one in targets.values() if one.recognise(name, file.text)), None)


def target_of_file(file: TextFile, targets: Targets = TARGETS) -> Target:
    """The target whose file it is.

    Raises:
        InputError: It is of none; the message lists what is known.
    """
    found = recognised(file, targets)
    if found is None:
        message = f"no known firmware writes this; known: {known_files(targets)}"
        raise InputError(message, source=file.source, line=1)
    return found


def read_configuration(
    places: Sequence[str | Path], targets: Targets = TARGETS
) -> tuple[Configuration, list[TextFile]]:
    """The configuration in one file, or in several of one firmware, and those files.

    Raises:
        InputError: A file cannot be read, is of no known firmware, is not what that writes, or is
            of another one than the first.
    """
    files = [read_text_file(place) for place in places]
    target = target_of_file(files[0], targets)
    for file in files[1:]:
        other = target_of_file(file, targets)
        if other is not target:
            message = (
                f"is a file of {other.method.name}, the first is one of {target.method.name}; name "
                "files of one firmware"
            )
            raise InputError(message, source=file.source, line=1)
    return together(target, files), files


def together(target: Target, files: Sequence[TextFile]) -> Configuration:
    """The configuration that several files of one firmware state together.

    Raises:
        InputError: As `read_file`.
    """
    if target.read_several is not None and len(files) > 1:
        with in_file(files[0].source):
            return target.read_several([(file.text, file.source) for file in files])
    found = read_file(target, files[0])
    for file in files[1:]:
        found = merged(found, read_file(target, file))
    return found


def read_file(target: Target, file: TextFile) -> Configuration:
    """The configuration in one file.

    Raises:
        InputError: It is not what the firmware writes, or its numbers are beyond all bounds.
    """
    with in_file(file.source):
        return target.read(file.text, file.source)


@contextmanager
def in_file(source: str) -> Iterator[None]:
    """Block that works on a file: its refusals and numerical trouble are InputError with the file
    and a line, the first where they are about the file as a whole.
    """
    try:
        with numerical_errors():
            yield
    except NoSolutionError as error:
        raise InputError(error.message, source=source, line=1) from None
    except InputError as error:
        error.source = source if error.source is None else error.source
        error.line = 1 if error.line is None else error.line
        raise


def merged(first: Configuration, second: Configuration) -> Configuration:
    """Two files of one firmware as one; where both say something else, the first counts, and the
    contradiction is named.
    """
    drive, contradictions = {}, [*first.contradictions, *second.contradictions]
    for part in fields(DriveValues):
        mine, other = getattr(first.drive, part.name), getattr(second.drive, part.name)
        drive[part.name] = other if mine is None else mine
        if mine is not None and other is not None and mine != other:
            contradictions.append(_contradiction(first, second, part.name))
    return replace(
        first,
        drive=DriveValues(**drive),
        current_d=first.current_d or second.current_d,
        current_q=first.current_q or second.current_q,
        speed=first.speed or second.speed,
        own={**second.own, **first.own},
        origins={**second.origins, **first.origins},
        conventions=tuple(dict.fromkeys((*first.conventions, *second.conventions))),
        contradictions=tuple(dict.fromkeys(contradictions)),
    )


def _contradiction(first: Configuration, second: Configuration, name: str) -> str:
    said = [_said(configuration, name) for configuration in (first, second)]
    return f"{said[0]} and {said[1]} do not agree: the first counts"


def _said(configuration: Configuration, name: str) -> str:
    origin = configuration.origins.get(name)
    value = getattr(configuration.drive, name)
    return f"{name} {value:g}" if origin is None else f"{origin.key} {origin.text}"


# What does not settle is not exported.


def settling_verdicts(
    design: Design, fits: Sequence[FirmwareFit], told: Callable[[str], None]
) -> Iterator[Verdict]:
    """Run the loops of each firmware on the design's machine, one after the other.

    All that modulate alike run in one program, which is compiled once.

    Args:
        design: The design.
        fits: What each firmware is given of it.
        told: Called with the name of each before it runs.

    Raises:
        NoSolutionError, VerificationError: As `require_settling`.
    """
    with ExitStack() as stack:
        programs: dict[str, Simulator] = {}
        for fit in fits:
            told(fit.name)
            kind = modulation_of(fit.profile)
            if kind not in programs:
                made = firmware_simulator(fit.profile, fit.configuration.drive)
                programs[kind] = stack.enter_context(made)
            yield require_settling(design, fit, programs[kind])


def require_settling(design: Design, fit: FirmwareFit, program: Simulator | None = None) -> Verdict:
    """Run the loops of a firmware on the design's machine.

    Args:
        design: The design.
        fit: What the firmware is given of it.
        program: A compiled one of the same modulation, where it is there already.

    Raises:
        NoSolutionError: They do not settle; says which step does not, and what the margins say.
        VerificationError: There is no C compiler.
    """
    verdict = settles(fit.profile, design, fit.configuration.drive, program=program)
    if not verdict.settles:
        why = "; ".join((verdict.reason, *fit.judged.faults[:1]))
        asked_for = design.control.firmware
        within = asked_for is not None and asked_for.name == fit.name
        calmer = calmer_bandwidth(design, fit, verdict, program)
        if calmer is not None:
            advice = (
                f"write method: bandwidth and bandwidth: {calmer:g} Hz under control.speed_loop, "
                "with which they settle"
            )
        elif within:
            advice = "choose slower loops under control"
        else:
            advice = f"write control.firmware: {fit.name} to have gains chosen within its structure"
        raise NoSolutionError(
            f"export.firmware: {fit.name} does not control this drive, nothing is written: {why}; "
            f"{advice}, or --no-verify to write the file nevertheless"
        )
    return verdict


def settling_text(verdict: Verdict) -> str:
    """What was tried, in one line."""
    steps = ", ".join(step.name for step in verdict.tried) or "nothing"
    left = f"; not tried: {'; '.join(verdict.left_out)}" if verdict.left_out else ""
    return f"the loops of {verdict.firmware} settle (tried: {steps}){left}"


# A slower speed loop for firmware that does not settle with that of the design.

_BANDWIDTHS = (50.0, 20.0, 10.0, 5.0, 2.0)  # In Hz; those that are tried, fastest first.


def calmer_bandwidth(
    design: Design, fit: FirmwareFit, verdict: Verdict, program: Simulator | None
) -> float | None:
    """Fastest of a few bandwidths in Hz with which the loops settle, where it is the speed that
    does not; None where none of them does, or something else is wrong.

    Args:
        design: The design.
        fit: What the firmware is given of it.
        verdict: What came of its loops.
        program: A compiled one of the same modulation, where it is there already.
    """
    settings = design.control.speed_loop
    failed = [step for step in verdict.tried if not step.settles]
    of_speed = all(
        step.quantity == "the speed" and step.answer.outcome != "steady error" for step in failed
    )
    inertia, asked = design.machine.inertia, fit.asked.speed
    if settings is None or inertia is None or asked is None or not of_speed:
        return None
    rate = asked.kp * design.machine.torque_per_ampere / inertia / (2.0 * math.pi)
    for bandwidth in _BANDWIDTHS:
        if bandwidth >= rate:
            continue
        slower = replace(settings, method="bandwidth", bandwidth=2.0 * math.pi * bandwidth)
        trial = replace(design, control=replace(design.control, speed_loop=slower))
        try:
            found = solve_firmware(trial, solve_gains(trial, proofs=False), [fit.name])[0]
        except (InputError, NoSolutionError):
            continue
        if settles(found.profile, trial, found.configuration.drive, program=program).settles:
            return bandwidth
    return None


# A design from files of a firmware: read, written as a design file, and checked as any other.

_SOURCE = "design.yaml"


@dataclass(frozen=True, slots=True)
class DesignFromFiles:
    """A design file's text, what it was made of, and keys that are missing in it, each with an
    example: those that a design needs, and those without which a part of the file is left out.
    """

    text: str
    configuration: Configuration
    missing: tuple[tuple[str, str], ...]
    wanted: tuple[tuple[str, str], ...]


def design_from_files(files: Sequence[Path], settings: Sequence[str] = ()) -> DesignFromFiles:
    """A design file from files of a firmware.

    Where it lacks nothing that a design needs, it has passed the checks of every design.

    Args:
        files: Of one firmware.
        settings: Keys that are set, such as ``inverter.v_dc=48 V``.

    Raises:
        InputError: A file is of no known firmware, or a value in it is none that a design can have.
    """
    configuration, read = read_configuration(files)
    names = [Path(file.source).name for file in read]
    given = {".".join(read_override(setting).parts) for setting in settings}
    with in_file(str(files[0])):
        made = design_of(configuration, names, pll=_pll(configuration), given=given)
    text = made.text
    if settings and made.missing:
        also = " ".join(f"--set {key}='{example}'" for key, example in made.missing)
        raise InputError(
            f"the file does not contain all that a design needs; give {also} as well",
            source=str(files[0]),
            line=1,
        )
    if not made.missing:
        text = _checked(text, settings, made, configuration, str(files[0]))
    return DesignFromFiles(text, configuration, made.missing, made.wanted)


def _pll(configuration: Configuration) -> PiGains | None:
    """The phase-locked loop that makes the speed of a firmware."""
    try:
        with numerical_errors():
            profile = profile_of(configuration)
    except (InputError, NoSolutionError):
        return None
    if profile.speed is None or profile.speed.feedback.kind != "pll":
        return None
    return PiGains(profile.speed.feedback.kp, profile.speed.feedback.ki)


def _origin(path: str, made: MadeDesign, configuration: Configuration) -> Origin | None:
    """Where the value of a key of the design stands, or of the first one below it."""
    below = (name for key, name in made.origins.items() if key.startswith(path) and path)
    names = (made.origins.get(path, ""), *below)
    return next(
        (configuration.origins[name] for name in names if name in configuration.origins), None
    )


def _checked(
    text: str,
    settings: Sequence[str],
    made: MadeDesign,
    configuration: Configuration,
    file: str,
) -> str:
    """The text with keys set; what is no design is refused in the place of the file that says
    it.
    """
    try:
        if settings:
            _, text = overridden(parse_yaml(text.encode("utf-8"), _SOURCE), text, settings)
        load_text(text.encode("utf-8"), _SOURCE)
    except InputError as error:
        if error.source != _SOURCE:
            raise
        path = ".".join(str(part) for part in leading_path(error.message))
        origin = _origin(path, made, configuration)
        if origin is None:
            raise InputError(error.message, source=file, line=1) from None
        message = f"{origin.key} {origin.text}: {error.message}"
        raise InputError(message, source=file, line=origin.line) from None
    return text


# A design file from the configuration of a firmware: every value with its source, what the file
# does not say as questions, its conventions and contradictions as comments.

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

_JUDGED = "# the file's gains are evaluated with any margin; 30 deg is usual"


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
        self._comment("Every value says where it stands there; missing values are marked QUESTION.")
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
            entry = (
                self._entry(field, text)
                if stated
                else f"{text}   # the usual one, not stated there"
            )
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
                    key.key,
                    f"{key.what}, with which its speed controller is evaluated",
                    key.example,
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
            self.lines.append(f"  firmware: {found.firmware}   # whose loops are evaluated")
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
        per_ampere = torque_per_ampere(drive.pole_pairs, drive.psi_pm)
        margin = "  " if inertia else "  # "
        if not inertia:
            self.lines.append("  # With machine.inertia the speed controller can be evaluated:")
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
    text = f"{float(f'{in_rpm(value):.9g}'):.9g} rpm"
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
