"""A complete design: the drive, what is asked of it, and where every value came from."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from dqforge.machines.design.settings import (
    ChoiceSettings,
    ControlSettings,
    ExportSettings,
    FitSettings,
    LossSettings,
    OperationSettings,
    WaveformSettings,
    WeakeningSettings,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.errors import InputError, KeyPath, Places, dotted
from dqforge.machines.files.input_files import MEGABYTE, read_regular_file
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.flux_maps.evidence import FluxEvidence
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat
from dqforge.machines.names import Strategy, Topology
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, amplitude_limit, sine_share
from dqforge.machines.units.quantities import format_quantity

# Constants of machines, each with the keys of the section ``machine`` that may give it.
CONSTANTS = {
    "pole_pairs": ("pole_pairs", "poles"),
    "r_s": ("resistance",),
    "l_d": ("inductance_d", "inductance"),
    "l_q": ("inductance_q", "inductance"),
    "l_s": ("self_inductance",),
    "m_s": ("mutual_inductance",),
    "psi_pm": ("magnet_flux", "back_emf_constant", "torque_constant", "kv"),
    "i_max": ("max_current",),
    "inertia": ("inertia",),
    "friction": ("friction",),
    "omega_m_max": ("max_speed",),
}


@dataclass(frozen=True, slots=True)
class DesignFiles:
    """What a design was read from: the bytes of its file, and those of each file that it names,
    by that name.
    """

    text: bytes
    named: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Design:
    """Everything one design file says, in SI units.

    ``machine`` is the drive in dq coordinates, of a machine with another than sinusoidal back-EMF
    its fundamental; ``phase_machine`` holds that back-EMF and any saliency, None for all others.
    ``values`` lists each quantity with its origin, ``assumptions`` the sentences on what the file
    leaves open, ``digest`` is the SHA-256 of the file's bytes in hexadecimal. ``weakening`` asks
    for two-dimensional references, ``modulation_choice`` for a choice of modulator and switching
    frequency.
    ``winding`` says how warm the losses make the winding, None where its temperature is given.
    ``simulation`` asks for a simulation in the time domain. ``given`` is what it was read from,
    None where it was made in Python. ``flux_evidence`` is what was found about each file of a flux
    map. ``halves`` are the machines that the current references of positive and of negative torque
    are made for, the second one mirrored in i_q and in the torque; None where one machine serves
    both. ``places`` says where its keys stand in its file, None for designs made by hand; it is no
    part of what makes two designs equal.
    """

    name: str
    about: str
    machine: Machine
    machine_loss: MachineLoss
    phase_machine: AnyPhaseMachine | None
    inverter: Inverter
    control: ControlSettings
    operation: OperationSettings
    fit: FitSettings
    losses: LossSettings | None
    waveform: WaveformSettings
    export: ExportSettings
    values: tuple[InputValue, ...]
    assumptions: tuple[str, ...]
    digest: str
    weakening: WeakeningSettings | None = None
    winding: WindingHeat | None = None
    simulation: Scenario | None = None
    modulation_choice: ChoiceSettings | None = None
    given: DesignFiles | None = None
    flux_evidence: tuple[FluxEvidence, ...] = ()
    halves: tuple[Machine, Machine] | None = None
    places: Places | None = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        """Name, machine and inverter in a few lines; `values` says all that the file says."""
        machine = self.machine if self.phase_machine is None else self.phase_machine
        inverter = f"{self.inverter.v_dc:g} V, {self.inverter.f_sw:g} Hz"
        keys = {value.path: value.text for value in self.values}
        origins = [
            f"{name}: {key} {keys[f'machine.{key}']}"
            for name, candidates in CONSTANTS.items()
            for key in candidates
            if f"machine.{key}" in keys
        ]
        lines = [f"Design {self.name!r}", repr(machine), *([", ".join(origins)] if origins else [])]
        return "\n  ".join([*lines, f"{inverter}, digest {self.digest[:12]}"])

    @property
    def strategy(self) -> Strategy:
        """Which currents make the torque."""
        return self.operation.strategy

    @property
    def i_max(self) -> float:
        """Current limit in A (peak): the smaller of machine and inverter."""
        limits = [self.machine.i_max] + (
            [] if self.inverter.i_max is None else [self.inverter.i_max]
        )
        return min(limits)

    @property
    def v_max(self) -> float:
        """Phase amplitude in V (peak) that the currents may ask for: the linear range of
        topology and modulator less the margin.
        """
        return amplitude_limit(
            self.inverter, self.operation.modulation, self.operation.voltage_margin
        )


# Data-sheet conventions: what the printed constants mean for a machine in star or delta,
# and whether they agree.
#
# All results are per phase, peak, in SI units (docs/reference/inputs.md). The functions know
# nothing of files; the errors they raise have no position yet.
#
# With p pole pairs, psi the flux linkage of the magnets (peak of phase) and
# mechanical speed omega_m::
#
#     phase back-EMF (peak)   e = p omega_m psi
#     torque at i_d = 0       T = 3/2 p psi i_q
#
# A delta is converted to the star that acts alike at its terminals: with R', L', psi',
# i' of a winding
#
#     R = R'/3    L = L'/3    psi = psi'/sqrt(3)    i = sqrt(3) i'
#
# so that R i^2, L i^2, psi i and the torque are the same, and the flux of the winding between the
# terminals a and b peaks 30 degrees (electrical) before that of phase a.

Connection = Literal["star", "delta"]


AGREEMENT = 0.05  # relative difference up to which two statements are held to say the same


POWER_AGREEMENT = 0.10  # name plates round power, torque and speed separately


_SQRT2 = math.sqrt(2.0)


_SQRT3 = math.sqrt(3.0)


# Volts per mechanical rad/s times this are the peak of the phase voltage per mechanical rad/s.
_TO_PHASE_PEAK = {
    "phase peak": 1.0,
    "phase rms": _SQRT2,
    "line-to-line peak": 1.0 / _SQRT3,
    "line-to-line rms": _SQRT2 / _SQRT3,
}


_FLUX_TO_PEAK = {"peak": 1.0, "rms": _SQRT2, "power-invariant": math.sqrt(2.0 / 3.0)}


def phase_resistance(value: float, kind: str, connection: Connection = "star") -> float:
    """Resistance in Ohm of a phase of the star, or of the star that acts like the delta.

    Between two terminals of either lie two phases of the star; one winding of a
    delta has three times a phase.
    """
    return value / _phases_in(kind, connection)


def phase_inductance(value: float, kind: str, connection: Connection = "star") -> float:
    """Phase (synchronous) inductance in H, converted like a resistance."""
    return value / _phases_in(kind, connection)


def _phases_in(kind: str, connection: Connection) -> float:
    """What a resistance or an inductance is divided by."""
    if kind == "line-to-line":
        return 2.0
    return 3.0 if connection == "delta" else 1.0


def peak_current(value: float, kind: str, connection: Connection = "star") -> float:
    """Peak current of a line in A from a peak or r.m.s. value of a line or a winding.

    In a star the two are the same; in a delta a line carries the difference of two windings,
    sqrt(3) times as much.
    """
    peak = value * _SQRT2 if kind.endswith("rms") else value
    return peak * _SQRT3 if connection == "delta" and kind.startswith("winding") else peak


def peak_flux(value: float, kind: str, connection: Connection = "star") -> float:
    """Flux linkage in Wb, peak of phase, from peak, r.m.s. or power-invariant
    (sqrt(3/2) times the peak).

    That of a winding in delta lies between two terminals and is sqrt(3) times
    that of a phase of the star.
    """
    peak = value * _FLUX_TO_PEAK[kind]
    return peak / _SQRT3 if connection == "delta" else peak


def flux_from_back_emf(
    constant: float, kind: str, pole_pairs: int, connection: Connection = "star"
) -> float:
    """Flux linkage in Wb (peak of phase) from a back-EMF constant in V per mechanical rad/s.

    The voltage of a phase in delta is the one between two terminals.
    """
    of_terminals = kind.replace("phase", "line-to-line") if connection == "delta" else kind
    return constant * _TO_PHASE_PEAK[of_terminals] / pole_pairs


def flux_from_kv(kv: float, kind: str, pole_pairs: int, connection: Connection = "star") -> float:
    """Flux linkage in Wb (peak of phase) from a speed constant in rpm per volt, the reciprocal of
    the back-EMF constant of its kind.

    That of a hobby motor is per volt of the line-to-line peak.
    """
    return flux_from_back_emf(30.0 / (math.pi * kv), kind, pole_pairs, connection)


def flux_from_torque_constant(
    constant: float, kind: str, pole_pairs: int, connection: Connection = "star"
) -> float:
    """Flux linkage in Wb (peak of phase) from a torque constant in N m per ampere, peak or r.m.s.,
    of line or winding.

    One ampere of the kind is a peak current of the line of `peak_current`.
    """
    return constant / peak_current(1.0, kind, connection) / (1.5 * pole_pairs)


@dataclass(frozen=True, slots=True)
class FluxStatement:
    """One key that implies the flux linkage of the magnets.

    ``key`` is its name, ``text`` what the file says, ``psi_pm`` the flux linkage in Wb (peak of
    phase) that follows. ``counts_poles`` tells whether the number of pole pairs entered into it.
    """

    key: str
    text: str
    psi_pm: float
    counts_poles: bool


def check_flux_agreement(statements: Sequence[FluxStatement], pole_pairs: int) -> None:
    """Refuse statements that imply different flux linkages.

    Args:
        statements: In order of trust; each is compared with the first.
        pole_pairs: Number of pole pairs that was used.

    Raises:
        InputError: Two statements differ by more than 5 %; the message says what each implies and
            the likely cause.
    """
    if not statements:
        return
    first = statements[0]
    for other in statements[1:]:
        if abs(other.psi_pm - first.psi_pm) <= AGREEMENT * max(other.psi_pm, first.psi_pm):
            continue
        implied = " and ".join(
            f"{s.key} {s.text} implies psi_pm = {format_quantity(s.psi_pm, 'Wb', 4)}"
            for s in (first, other)
        )
        raise InputError(
            f"{implied}: they contradict each other{likely_cause(first, other, pole_pairs)}"
        )


def likely_cause(first: FluxStatement, other: FluxStatement, pole_pairs: int) -> str:
    """Sentence on the mistake that would explain the ratio of two flux linkages,
    or advice to check both.

    The number of poles cancels between back-EMF and torque constant,
    so it is blamed only where it does not.
    """
    if first.psi_pm <= 0.0 or other.psi_pm <= 0.0:
        return "; a machine without magnets has neither constant, remove one of the keys"
    ratio = first.psi_pm / other.psi_pm
    size = max(ratio, 1.0 / ratio)
    causes = [text for factor, text in _FACTORS if abs(size / factor - 1.0) < 0.03]
    if first.counts_poles != other.counts_poles:
        # The statement that counts poles has p below the line: with 2p for p
        # it comes out half as large.
        too_small = ratio if other.counts_poles else 1.0 / ratio
        if abs(too_small / 2.0 - 1.0) < 0.03:
            causes.insert(
                0,
                (
                    f"pole_pairs {pole_pairs} looks like the number of poles; write poles: "
                    f"{pole_pairs}"
                ),
            )
        elif abs(too_small * 2.0 - 1.0) < 0.03:
            poles = 2 * pole_pairs
            causes.insert(
                0,
                f"the {poles} poles look like the number of pole pairs; write pole_pairs: {poles}",
            )
        elif pole_pairs > 1 and abs(size / pole_pairs - 1.0) < 0.03:
            causes.append("a constant per electrical speed given per mechanical speed?")
    advice = " or ".join(causes) if causes else "check both keys, their units and their kinds"
    return f" by the factor {size:.3g}; {advice}"


_FACTORS = (
    (_SQRT2, "an r.m.s. value given as peak, or the reverse? check the kinds"),
    (_SQRT3, "a line-to-line value given as phase, or the reverse? check the kinds"),
    (
        _SQRT2 * _SQRT3,
        "a line-to-line r.m.s. value given as phase peak, or the reverse? check the kinds",
    ),
    (
        _SQRT3 / _SQRT2,
        (
            "a power-invariant flux given as peak, or line-to-line r.m.s. as phase peak? check the "
            "kinds"
        ),
    ),
    (1.5, "a torque constant without the 3/2 of the amplitude-invariant currents?"),
    (2.0 * math.pi, "a value per revolution given per radian?"),
    (30.0 / math.pi, "a value per rpm or krpm given per rad/s? check the unit"),
    (1000.0 * math.pi / 30.0, "a value per krpm given per rad/s? check the unit"),
    (1000.0, "V/krpm given as V/rpm, or milli omitted? check the unit"),
)


def check_pole_counts(pole_pairs: int | None, poles: int | None) -> int:
    """Return the number of pole pairs from one of its two spellings.

    Raises:
        InputError: None is given, they contradict each other, or the number of poles is odd.
    """
    if poles is not None and poles % 2:
        hint = (
            f"write pole_pairs: {poles}" if pole_pairs is None else f"write poles: {2 * pole_pairs}"
        )
        raise InputError(
            f"{poles} poles cannot be, poles come in pairs; if these are pole pairs, {hint}"
        )
    if pole_pairs is None and poles is None:
        raise InputError("needs the number of poles; write poles: 8 (or pole_pairs: 4)")
    if pole_pairs is not None and poles is not None and poles != 2 * pole_pairs:
        raise InputError(
            f"poles {poles} means {poles // 2} pole pairs, but pole_pairs is {pole_pairs}; "
            "remove the wrong one"
        )
    return pole_pairs if pole_pairs is not None else (poles or 0) // 2


def check_rated_frequency(pole_pairs: int, frequency: float, omega_m: float) -> None:
    """Refuse a rated frequency (Hz) and speed (rad/s) that do not belong to
    the number of pole pairs.

    Raises:
        InputError: f and p omega_m/(2 pi) differ by more than 5 %.
    """
    expected = pole_pairs * omega_m / (2.0 * math.pi)
    if abs(frequency - expected) <= AGREEMENT * max(frequency, expected):
        return
    speed = format_quantity(omega_m, "rpm")
    implied = frequency * 2.0 * math.pi / omega_m
    nearest = round(implied)
    if nearest == 0 or abs(implied - nearest) > AGREEMENT * nearest:
        advice = "check both; an asynchronous machine has slip, this one must not"
    elif pole_pairs == 2 * nearest:
        advice = (
            f"pole_pairs {pole_pairs} looks like the number of poles; write poles: {pole_pairs}"
        )
    else:
        advice = f"they belong to {nearest} pole pairs; write pole_pairs: {nearest}"
    raise InputError(
        f"{pole_pairs} pole pairs at the rated speed {speed} make "
        f"{format_quantity(expected, 'Hz')}, but rated.frequency is "
        f"{format_quantity(frequency, 'Hz')}: {advice}"
    )


def check_rated_power(power: float, torque: float, omega_m: float) -> None:
    """Refuse a rated power (W) that is not rated torque (N m) times speed (rad/s) within 10 %.

    Raises `InputError`.
    """
    expected = torque * omega_m
    if abs(power - expected) <= POWER_AGREEMENT * max(power, expected):
        return
    raise InputError(
        f"rated.power is {format_quantity(power, 'W')}, but rated.torque "
        f"{format_quantity(torque, 'N m')} times rated.speed {format_quantity(omega_m, 'rpm')} is "
        f"{format_quantity(expected, 'W')}; correct one of the three or remove it"
    )


def check_rated_torque(torque: float, largest: float) -> None:
    """Refuse a rated torque (N m) beyond what the machine gives at its current limit.

    Raises `InputError`.
    """
    if torque <= (1.0 + POWER_AGREEMENT) * largest:
        return
    raise InputError(
        f"rated.torque {format_quantity(torque, 'N m')} is more than the "
        f"{format_quantity(largest, 'N m')} that the machine gives at max_current; check the kind "
        "of max_current (peak or rms), the pole number and the flux"
    )


def back_emf_warning(
    pole_pairs: int,
    psi_pm: float,
    omega_m_max: float,
    v_dc: float,
    topology: Topology = "three-wire",
) -> str:
    """Sentence on a back-EMF above the DC link at the largest speed (rad/s), or an empty text."""
    phase = pole_pairs * omega_m_max * psi_pm
    if TOPOLOGIES[topology].between != 1.0:  # not the difference of two phases limits
        most = sine_share(topology) * v_dc
        if phase <= most:
            return ""
        return (
            f"at {format_quantity(omega_m_max, 'rpm')} the back-EMF of a phase peaks at "
            f"{format_quantity(phase, 'V')}, above the {format_quantity(most, 'V')} that "
            f"{topology} makes from v_dc = {format_quantity(v_dc, 'V')}: that speed needs field "
            "weakening, and losing it charges the link"
        )
    peak = _SQRT3 * pole_pairs * omega_m_max * psi_pm
    if peak <= v_dc:
        return ""
    return (
        f"at {format_quantity(omega_m_max, 'rpm')} the back-EMF between two terminals peaks at "
        f"{format_quantity(peak, 'V')}, above v_dc = {format_quantity(v_dc, 'V')}: "
        "that speed needs field weakening, and losing it charges the link"
    )


# What is gathered while a design file is read: conversions, remarks,
# and the files that it names.

MAX_FILE_BYTES = 256_000_000
_MOST_RECALLED = 256
_Made = TypeVar("_Made")


def with_slashes(name: str) -> str:
    """The name of a file as every system reads it; a design from Windows may have the other kind
    of slash.
    """
    return name.replace("\\", "/")


@dataclass(frozen=True, slots=True)
class Recalled:
    """What was made once, and what making it added to each list of its `Reading`."""

    made: object
    added: tuple[tuple[Any, ...], ...]


@dataclass(slots=True)
class Reading:
    """A design file in the course of being read.

    Args:
        document: The file with its positions.
        text: Its bytes.
        folder: Where the files lie that it names, or None where it may name none.

    ``converted`` holds for paths of converted values what is used and what was done, ``derived``
    values that follow from others, ``remarks`` sentences on what the file leaves open, ``files``
    the bytes of the files that it names, ``names`` the names of these (empty for what the package
    ships), ``flux_evidence`` what was found about its flux maps. ``connection`` is that of the
    machine's windings. ``supplied`` holds the files that may be named where they are in memory,
    None where they lie in ``folder``. ``memory`` keeps what files and coefficients became, for
    other readings that share it (`recalled`).
    """

    document: YamlDocument
    text: bytes
    folder: Path | None
    converted: dict[str, tuple[float, str]] = field(default_factory=dict)
    derived: list[InputValue] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    files: list[bytes] = field(default_factory=list)
    flux_evidence: list[FluxEvidence] = field(default_factory=list)
    connection: Connection = "star"
    names: list[str] = field(default_factory=list)
    supplied: Mapping[str, bytes] | None = None
    memory: dict[Hashable, Recalled] | None = None

    def given(self) -> DesignFiles:
        """Everything that was read, from which the same design can be read again."""
        named = {
            name: content for name, content in zip(self.names, self.files, strict=True) if name
        }
        return DesignFiles(self.text, tuple(named.items()))

    def digest(self) -> str:
        """SHA-256 of the design file, or of its bytes and the digests of the files that it names,
        in their order.
        """
        if not self.files:
            return hashlib.sha256(self.text).hexdigest()
        whole = self.text + b"".join(hashlib.sha256(content).digest() for content in self.files)
        return hashlib.sha256(whole).hexdigest()

    def peak(self, quantity: Quantity, path: str) -> float:
        """Peak of a current entry, with a note when it was converted."""
        value = peak_current(quantity.si, quantity.kind or "peak")
        if quantity.kind == "rms":
            self.converted[path] = (value, "r.m.s. value times sqrt(2)")
        return value

    def machine_peak(self, quantity: Quantity, path: KeyPath) -> float:
        """Peak current of a line from a current of the machine, with a note when it was converted.

        Raises:
            InputError: The machine is in delta, and the kind leaves open whether a line or a
                winding is meant.
        """
        kind, name = quantity.kind or "peak", dotted(path)
        self.check_current_kind(quantity, path)
        value = peak_current(quantity.si, kind, self.connection)
        parts = ["r.m.s. value times sqrt(2)"] if kind.endswith("rms") else []
        if self.connection == "delta" and kind.startswith("winding"):
            parts.append("current of a winding times sqrt(3) is that of a line")
        if parts:
            self.converted[name] = (value, "; ".join(parts))
        return value

    def check_current_kind(self, quantity: Quantity, path: KeyPath) -> None:
        """Refuse a kind of current that a delta leaves open; raises `InputError`."""
        kind = quantity.kind or "peak"
        if self.connection == "delta" and " " not in kind:
            raise self.document.error(
                f"{dotted(path)}: in a delta the current of a line is sqrt(3) times that of a "
                f"winding; write {{value: {quantity.text}, kind: line {kind}}} or kind: winding "
                f"{kind}",
                path,
            )

    def per_phase(self, quantity: Quantity, path: str) -> float:
        """Phase value of a resistance or inductance, with a note when it was converted."""
        kind = quantity.kind or "phase"
        value = phase_resistance(quantity.si, kind, self.connection)
        if kind == "line-to-line":
            star = (
                "star connection" if self.connection == "star" else "equivalent star of the delta"
            )
            self.converted[path] = (value, f"half of the line-to-line value ({star})")
        elif self.connection == "delta":
            self.converted[path] = (
                value,
                "a third of the winding's value (equivalent star of the delta)",
            )
        return value

    def phase_flux(self, quantity: Quantity, path: str) -> float:
        """Flux linkage of a phase in Wb (peak), with a note when it was converted."""
        kind = quantity.kind or "peak"
        value = peak_flux(quantity.si, kind, self.connection)
        parts = [f"peak of phase from the {kind} value"] if kind != "peak" else []
        if self.connection == "delta":
            parts.append("that of a winding over sqrt(3) (equivalent star of the delta)")
        if parts:
            self.converted[path] = (value, "; ".join(parts))
        return value

    def recalled(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What ``make`` returns, from memory where another reading has made it for ``key``.

        What it adds to this reading on the way (files, remarks, values) is added again.
        """
        if self.memory is None:
            return make()
        kept = self.memory.get(key)
        lists: tuple[list[Any], ...] = (
            self.derived,
            self.remarks,
            self.files,
            self.flux_evidence,
            self.names,
        )
        if kept is None:
            before = [len(entries) for entries in lists]
            made = make()
            added = tuple(
                tuple(entries[count:]) for entries, count in zip(lists, before, strict=True)
            )
            if len(self.memory) >= _MOST_RECALLED:
                self.memory.pop(next(iter(self.memory)))
            self.memory[key] = Recalled(made, added)
            return made
        for entries, more in zip(lists, kept.added, strict=True):
            entries.extend(more)
        return cast("_Made", kept.made)

    def is_beside(self, name: str) -> bool:
        """Whether there is such a file in the folder of the design or below it."""
        name = with_slashes(name)
        if self.supplied is not None:
            return self.supplied.get(name) is not None
        return self.folder is not None and (self.folder / name).is_file()

    def read_beside(self, name: str, path: KeyPath, most_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Content of a file that the design names, from its own folder or one below it.

        Raises:
            InputError: The name leads elsewhere, or the file cannot be read or is too large.
        """
        name = with_slashes(name)
        if self.supplied is not None:
            content = self._in_memory(name, path, most_bytes)
            self.files.append(content)
            self.names.append(name)
            return content
        if self.folder is None:
            raise self.document.error("a design of the library cannot name files", path)
        home = self.folder.resolve()
        try:
            place = (home / name).resolve()
        except (OSError, RuntimeError):  # links that lead in a circle
            raise self.document.error(
                f"the links of '{name}' lead in a circle; name the file itself", path
            ) from None
        if not place.is_relative_to(home) or Path(name).is_absolute():
            raise self.document.error(
                f"the file '{name}' lies outside the folder of the design; copy it beside the "
                "design file",
                path,
            )
        try:
            if not place.exists():
                raise self.document.error(
                    f"there is no file '{name}' beside the design file; check the name", path
                )
            content = read_regular_file(place, most_bytes, name)
        except OSError as error:
            raise self.document.error(
                f"the file '{name}' cannot be read: {error.strerror}", path
            ) from None
        except InputError as error:
            if error.source != name:
                raise
            raise self.document.error(f"the file '{name}': {error.message}", path) from None
        self.files.append(content)
        self.names.append(name)
        return content

    def _in_memory(self, name: str, path: KeyPath, most_bytes: int) -> bytes:
        """One of the supplied files; raises `InputError` where it is not there or too large."""
        content = None if self.supplied is None else self.supplied.get(name)
        if content is None:
            raise self.document.error(
                f"there is no file '{name}' beside the design file; check the name", path
            )
        if len(content) > most_bytes:
            raise self.document.error(
                f"the file '{name}' has {len(content) / MEGABYTE:.4g} MB, at most "
                f"{most_bytes / MEGABYTE:.4g} MB can be read",
                path,
            )
        return content


# A torque that is written as the limit itself, rounded, is meant to be the limit.
ROUNDING_OF_DATA = 1e-3


# One value of a design with its origin, as it is shown and traced.


# Keys whose value in SI is of the convention that the file names.
_KEPT_KINDS = ("machine.back_emf_constant", "machine.torque_constant", "machine.kv")


@dataclass(frozen=True, slots=True)
class InputValue:
    """One value of the design as it was read.

    ``path`` is the dotted key, ``text`` what the file says, ``si`` the value in SI with its
    ``unit``, ``source`` where the author says it comes from, ``inferred`` whether it was deduced,
    ``note`` what was converted or assumed.
    """

    path: str
    text: str
    si: float
    unit: str
    source: str = ""
    inferred: bool = False
    note: str = ""

    @property
    def kind(self) -> str:
        """Convention of a constant whose SI value keeps it, such as ``line-to-line rms``; empty of
        values that are converted to peak of phase.
        """
        _, opened, kind = self.text.removesuffix(")").rpartition("(")
        return kind if opened and self.path in _KEPT_KINDS else ""
