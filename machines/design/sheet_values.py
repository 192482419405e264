"""The values that a data sheet has and a design is made of: one table, from which the options of
the command line, the questions in a terminal and the comments of the design file come.

Nothing is loaded here, so that ``dqforge --help`` answers at once.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from dqforge.machines.records import dataclass

_TERMINALS = (
    ("line-to-line", "between two terminals"),
    ("phase", "of one phase, terminal to star point"),
)

_CURRENT = (("peak", "peak of the sine"), ("rms", "r.m.s."))

_PER_CURRENT = (("rms", "per ampere r.m.s."), ("peak", "per ampere of the peak"))


@dataclass(frozen=True, slots=True)
class SheetValue:
    """One value of a data sheet.

    Args:
        key: Dotted key of the design.
        what: What it is, as a heading.
        where: Where and under which name a data sheet has it.
        example: What might be written.
        convention: What is assumed of it and why, in sentences.
        use: What it is for, where it may be left out.
        kinds: Conventions between which a text without one leaves the choice, each with its
            meaning; the first is the usual one.
        need: Name of what a design needs, to which it is one way.
        instead: Keys of which one makes it needless.
        option: Option of the command line where that is not the last word of the key.
        dimension: What a number is of; empty for a count and for the name.
    """

    key: str
    what: str
    where: str
    example: str
    convention: str = ""
    use: str = ""
    kinds: tuple[tuple[str, str], ...] = ()
    need: str = ""
    instead: tuple[str, ...] = ()
    option: str = ""
    dimension: str = ""

    @property
    def flag(self) -> str:
        """Option of the command line."""
        return f"--{self.option or self.label}"

    @property
    def label(self) -> str:
        """Short name: its last word, or words of the rated values."""
        return self.key.removeprefix("machine.").rpartition("inverter.")[2].translate(_DASHES)


_DASHES = str.maketrans("._", "--")


SHEET_VALUES = (
    SheetValue(
        "name",
        "Name of the drive",
        "one line, for header and report",
        "Hub motor 48 V",
        use="heads header and report",
    ),
    SheetValue(
        "machine.pole_pairs",
        "Pole pairs",
        "p, or half the magnets around the rotor: 12N14P has 14 poles, 7 pairs",
        "7",
        "Pole pairs, not poles: the electrical angle is that of the shaft times them.",
        need="poles",
        instead=("machine.poles",),
    ),
    SheetValue(
        "machine.poles",
        "Poles",
        "2p, the magnets around the rotor, the 14 of 12N14P",
        "14",
        "Poles, of which two are a pair: the electrical angle is that of the shaft times the "
        "pairs.",
        need="poles",
        instead=("machine.pole_pairs",),
    ),
    SheetValue(
        "machine.kv",
        "Kv, speed per volt without load",
        "in the name of hobby motors (190KV), rpm/V",
        "190 rpm/V",
        "Kv in mechanical rpm per volt of the peak between two terminals, as hobby motors have "
        "it: speed without load over the voltage of the battery. If r.m.s. volts are counted, "
        "write 'line-to-line rms' behind the value.",
        need="magnets",
        dimension="speed-constant",
    ),
    SheetValue(
        "machine.back_emf_constant",
        "Back-EMF constant Ke",
        "K_E, voltage constant; V/krpm, V/1000 min^-1, mV/rpm",
        "60 V/krpm line-to-line rms",
        "Voltage without load per mechanical speed. Servo data sheets mean r.m.s. between two "
        "terminals, textbooks the peak of a phase, which is 0.82 of it.",
        kinds=(
            ("line-to-line rms", "r.m.s. between two terminals, as on servo data sheets"),
            ("line-to-line peak", "peak between two terminals"),
            ("phase rms", "r.m.s. of a phase"),
            ("phase peak", "peak of a phase"),
        ),
        need="magnets",
        instead=("machine.kv",),
        option="back-emf",
        dimension="back-emf",
    ),
    SheetValue(
        "machine.torque_constant",
        "Torque constant Kt",
        "K_T; N m per ampere of the phase current, or oz-in/A",
        "0.38 Nm/Arms",
        "Torque per ampere of sinusoidal phase current, which servo data sheets count r.m.s.; "
        "it is compared with Kv or Ke. A Kt computed as 9.55/Kv is that of direct current "
        "through two phases: omit it.",
        use="a second value for the magnet flux, checked against the first",
        kinds=_PER_CURRENT,
        need="magnets",
        dimension="torque-constant",
    ),
    SheetValue(
        "machine.magnet_flux",
        "Flux linkage of the magnets",
        "psi_PM or lambda, as VESC Tool or a drive measures it",
        "6.1 mWb",
        "Flux linkage of the magnets: peak of a phase, unless rms or power-invariant stands "
        "behind the value.",
        need="magnets",
        instead=("machine.kv", "machine.back_emf_constant", "machine.torque_constant"),
        dimension="flux",
    ),
    SheetValue(
        "inverter.v_dc",
        "Voltage of the dc link",
        "the battery, or 1.35 times the line voltage behind a rectifier",
        "48 V",
        "Where the dc link sags, the least voltage that the drive shall still work at: it "
        "limits the speed.",
        need="voltage",
        dimension="voltage",
    ),
    SheetValue(
        "machine.max_current",
        "Largest phase current",
        "I_max of the motor or of the inverter, the smaller; not that of the battery",
        "40 A rms",
        "Of a phase, not of the battery. The peak of a sine is 1.41 times its r.m.s. value.",
        kinds=_CURRENT,
        need="current",
        dimension="current",
    ),
    SheetValue(
        "machine.resistance",
        "Resistance of the winding",
        "R, R20, phase-to-phase, terminal resistance",
        "100 mOhm line-to-line",
        "Between two terminals lie two phases, of a star and of a delta alike: half is used. "
        "Thin leads between motor and inverter belong to it.",
        kinds=_TERMINALS,
        need="resistance",
        dimension="resistance",
    ),
    SheetValue(
        "machine.inductance",
        "Inductance, one for both axes",
        "L, phase-to-phase, terminal inductance; leave empty where Ld and Lq are given",
        "200 uH line-to-line",
        "One inductance for both axes, as of magnets on the surface of the rotor. Between two "
        "terminals lie two phases: half is used. If it changes as the rotor is turned, give "
        "both axes.",
        kinds=_TERMINALS,
        need="inductance",
        instead=("machine.inductance_d", "machine.inductance_q"),
        dimension="inductance",
    ),
    SheetValue(
        "machine.inductance_d",
        "Inductance along the magnets",
        "Ld, the smaller one of buried magnets",
        "1.61 mH phase",
        "Along the magnets. Between two terminals, with the rotor where it is least, lie two "
        "phases.",
        kinds=_TERMINALS,
        need="inductance",
        instead=("machine.inductance",),
        dimension="inductance",
    ),
    SheetValue(
        "machine.inductance_q",
        "Inductance across the magnets",
        "Lq, the larger one of buried magnets",
        "1.74 mH phase",
        "Across the magnets. Between two terminals, with the rotor where it is largest, lie two "
        "phases.",
        kinds=_TERMINALS,
        need="inductance",
        instead=("machine.inductance",),
        dimension="inductance",
    ),
    SheetValue(
        "inverter.switching_frequency",
        "Switching frequency of the inverter",
        "PWM frequency; the currents are sampled as often",
        "20 kHz",
        use="assumed if omitted",
        dimension="frequency",
    ),
    SheetValue(
        "machine.max_speed",
        "Largest speed of the shaft",
        "n_max, maximum mechanical speed",
        "3000 rpm",
        use="compared with what the dc link allows; scale of the speed",
        dimension="speed",
    ),
    SheetValue(
        "machine.rated.torque",
        "Rated torque",
        "M_N, T_N, continuous torque",
        "2.4 N m",
        use="name plate, for cross-checks",
        dimension="torque",
    ),
    SheetValue(
        "machine.rated.speed",
        "Rated speed",
        "n_N, nominal speed of the shaft",
        "3000 rpm",
        use="name plate, for cross-checks",
        dimension="speed",
    ),
    SheetValue(
        "machine.rated.current",
        "Rated phase current",
        "I_N, continuous current; name plates have r.m.s. values",
        "2.6 A rms",
        use="name plate, for cross-checks",
        kinds=_CURRENT[::-1],
        dimension="current",
    ),
    SheetValue(
        "machine.inertia",
        "Moment of inertia of all that turns",
        "J of the rotor; add that of the load",
        "2 kg cm^2",
        "Motor and load together: the speed controller is tuned for it.",
        use="motor and load, for a speed controller; without it there is none",
        dimension="inertia",
    ),
    SheetValue(
        "machine.friction",
        "Viscous friction",
        "torque per speed, from a run-down; seldom on a data sheet",
        "40e-6 N m s",
        use="damps the speed loop; 0 without it",
        dimension="friction",
    ),
)


BY_KEY = {value.key: value for value in SHEET_VALUES}

# A file with a flux map, and what its axes are; it says what magnets and inductances would.
FLUX_MAP, FLUX_AXES = "machine.flux_map.file", "machine.flux_map.axes"
MAP_FLAGS = {FLUX_MAP: "--map", FLUX_AXES: "--axes"}
_OF_MAP = ("magnets", "inductance")


def is_needless(value: SheetValue, known: Collection[str]) -> bool:
    """Whether others that are known take the place of a value."""
    return (FLUX_MAP in known and value.need in _OF_MAP) or not set(value.instead).isdisjoint(known)


def missing(known: Collection[str]) -> list[SheetValue]:
    """What a design still needs, each in the first way that is open."""
    found: list[SheetValue] = []
    for need in dict.fromkeys(value.need for value in SHEET_VALUES if value.need):
        if FLUX_MAP in known and need in _OF_MAP:
            continue
        ways = [value for value in SHEET_VALUES if value.need == need]
        if need == "inductance" and not set(_AXES).isdisjoint(known):
            found += [value for value in ways if value.key in _AXES and value.key not in known]
        elif known_none(ways, known):
            found.append(ways[0])
    return found


_AXES = ("machine.inductance_d", "machine.inductance_q")


def known_none(values: Collection[SheetValue], known: Collection[str]) -> bool:
    """Whether none of the values is known."""
    return all(value.key not in known for value in values)


def next_asked(
    known: Collection[str], skipped: Collection[str], *, needed_only: bool
) -> SheetValue | None:
    """The value that is asked for next; None where nothing is left.

    Args:
        known: Keys that have a value.
        skipped: Keys that were left empty.
        needed_only: Whether what may be left out is not asked for.
    """
    needs = {value.need for value in missing(known)}
    for value in SHEET_VALUES:
        if value.key in known or value.key in skipped or is_needless(value, known):
            continue
        if value.need in needs or not needed_only:
            return value
    return None


def must_be_answered(value: SheetValue, known: Collection[str], skipped: Collection[str]) -> bool:
    """Whether a value may not be left empty: it is the last open way to what a design needs."""
    if value.need not in {entry.need for entry in missing(known)}:
        return False
    if value.key in _AXES:
        return True
    others = (
        other
        for other in SHEET_VALUES
        if other.need == value.need and other.key not in (value.key, *known, *skipped)
    )
    return all(is_needless(other, known) for other in others)


def assumed_frequency(v_dc: float | None) -> tuple[str, str]:
    """Switching frequency that is assumed, and why.

    Args:
        v_dc: Voltage of the dc link (V), None where it is not known yet.
    """
    if v_dc is not None and v_dc > _MOSFETS_UP_TO:
        return "10 kHz", "usual of drives behind a rectifier"
    return "20 kHz", "usual of MOSFETs up to 120 V, above hearing"


_MOSFETS_UP_TO = 120.0


def as_command(folder: str, values: Mapping[str, str]) -> list[str]:
    """Words of the command that makes the same without a question."""
    words = ["dqforge", "new", folder]
    for value in SHEET_VALUES:
        if value.key in values:
            words += [value.flag, values[value.key]]
    return words
