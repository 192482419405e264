"""Configurations and judged loops of firmware as plain data, by the keys of
docs/reference/json.md, as tables, and as files.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from dqforge import __version__
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues
from dqforge.optimizer.firmware.solve import FirmwareFit
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart, Rows
from dqforge.reports.firmware.design_made import Targets, in_file, read_file, together
from dqforge.reports.firmware.target import TARGETS, FileTitle, Target, TextFile, decoded_file
from dqforge.reports.firmware_keys import conventions_here, meaning
from dqforge.reports.loops.firmware_text import pole_text
from dqforge.reports.pages.answer import Table, read_output
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import Chapter

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.configuration import LoopProfile, Origin, PiGains
    from dqforge.optimizer.firmware.firmware_method import JudgedFirmware, JudgedLoop, Shortfall
    from dqforge.optimizer.firmware.solve import Explained, OwnGains
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


# Keys of the fields of `DriveValues`, as under ``drive`` of ``result.json``.
DRIVE_KEYS = {
    "pole_pairs": "pole_pairs",
    "r_s": "r_s_Ohm",
    "l_d": "l_d_H",
    "l_q": "l_q_H",
    "psi_pm": "psi_pm_Wb",
    "inertia": "inertia_kg_m2",
    "viscous": "friction_Nms_per_rad",
    "i_max": "i_max_A",
    "omega_m_max": "omega_m_max_rad_per_s",
    "v_dc": "v_dc_V",
    "f_sw": "f_sw_Hz",
    "dead_time": "dead_time_s",
    "t_s": "t_s_s",
    "t_speed": "t_speed_s",
    "shunt": "shunt_Ohm",
    "sense_gain": "sense_gain",
    "sense_reference": "sense_reference_V",
}


def plain_drive_values(drive: DriveValues) -> PlainData:
    """Machine, limits and timing; null where they are not known."""
    return {key: getattr(drive, name) for name, key in DRIVE_KEYS.items()}


def plain_pi(gains: PiGains | None) -> PlainData | None:
    """Both gains of a controller."""
    return None if gains is None else asdict(gains)


def plain_configuration(found: Configuration) -> PlainData:
    """Everything that a configuration says, with the places in its file."""
    return {
        "firmware": found.firmware,
        "version": found.version,
        "name": found.name,
        "drive": plain_drive_values(found.drive),
        "current_d": plain_pi(found.current_d),
        "current_q": plain_pi(found.current_q),
        "speed": plain_pi(found.speed),
        "own": dict(found.own),
        "origins": {name: asdict(origin) for name, origin in found.origins.items()},
        "conventions": list(found.conventions),
        "contradictions": list(found.contradictions),
    }


def plain_loop(found: JudgedLoop | None) -> PlainData | None:
    """Margins of a loop."""
    if found is None:
        return None
    return {
        "crossover_rad_per_s": found.crossover,
        "phase_margin_rad": found.phase_margin,
        "gain_margin": found.gain_margin,
        "delay_margin_s": found.delay_margin,
        "max_sensitivity": found.max_sensitivity,
        "bandwidth_rad_per_s": found.bandwidth,
        "damping": found.damping,
        "stable": found.stable,
        "poles": [[pole.real, pole.imag] for pole in found.poles.tolist()],
        "t_s": found.t_s,
    }


def plain_loops(found: JudgedFirmware) -> PlainData:
    """The loops of a firmware, the poles of its phase-locked loop, and the remarks."""
    poles = found.pll_poles
    return {
        "i_d": plain_loop(found.current_d),
        "i_q": plain_loop(found.current_q),
        "speed": plain_loop(found.speed),
        "pll_poles": None if poles is None else [[pole.real, pole.imag] for pole in poles],
        "remarks": list(found.remarks),
    }


def plain_observer_of(profile: LoopProfile | None) -> PlainData | None:
    """The position observer of a firmware, None where it has none or is not known."""
    if profile is None or profile.observer is None:
        return None
    found = asdict(profile.observer)
    found["rate_rad_per_s"] = found.pop("rate")
    return found


def plain_shortfall(found: Shortfall) -> PlainData:
    """What a format cannot hold, with its prices."""
    return {
        "words": found.words,
        "prices": [
            {**asdict(price), "value": price.value if math.isfinite(price.value) else None}
            for price in found.prices
        ],
    }


def plain_fit(found: FirmwareFit) -> PlainData:
    """What a firmware is given of a design."""
    return {
        "configuration": plain_configuration(found.configuration),
        "loops": plain_loops(found.judged),
        "observer": plain_observer_of(found.profile),
        "shortfalls": [plain_shortfall(shortfall) for shortfall in found.shortfalls],
    }


def plain_explained(found: Explained) -> PlainData:
    """What a file amounts to."""
    return {
        "configuration": plain_configuration(found.configuration),
        "machine": plain_drive_values(found.drive),
        "loops": plain_loops(found.judged),
        "observer": plain_observer_of(found.profile),
    }


# Files of a firmware from what was solved for it, each read back and held against that.


def file_title(design: Design, fit: FirmwareFit) -> FileTitle:
    """What stands at the head of the files of a design."""
    return FileTitle(
        design.export.prefix,
        design.name,
        design.digest,
        __version__,
        tuple(shortfall.words for shortfall in fit.shortfalls),
    )


def target_named(fit: FirmwareFit, targets: Targets = TARGETS) -> Target:
    """The target of what was solved; raises InputError where its files are not written."""
    found = targets.get(fit.name)
    if found is None:
        raise InputError(f"export.firmware: files of {fit.name} are not written; omit it")
    return found


def firmware_files(
    design: Design,
    fit: FirmwareFit,
    existing: TextFile | None = None,
    targets: Targets = TARGETS,
) -> dict[str, bytes]:
    """Files of a firmware by name.

    Args:
        design: What was solved.
        fit: What the firmware is given of it.
        existing: A file of the firmware whose other fields are kept; it is then among the files
            under its own name, in its own encoding.
        targets: Those of the package, or others.

    Raises:
        InputError: The existing file is not one of the firmware.
        VerificationError: What was written does not read back as what was to be written.
    """
    target = target_named(fit, targets)
    if existing is None:
        files = target.write(fit.configuration, file_title(design, fit), None)
    else:
        files = _into(design, fit, existing, target)
    read_back(files, fit.configuration, target, whole=existing is None)
    return files


def _into(design: Design, fit: FirmwareFit, existing: TextFile, target: Target) -> dict[str, bytes]:
    """The existing file with the values of the design, and no other file."""
    check_existing(existing, target)
    own = PurePath(existing.source).name
    try:
        with in_file(existing.source):
            files = target.write(fit.configuration, file_title(design, fit), existing.text)
    except InputError as error:
        error.source = existing.source  # which writers do not know
        raise
    alike = [name for name in files if PurePath(name).suffix == PurePath(own).suffix]
    readable = [name for name in alike or files if _recognised(target, own, files[name])]
    if not readable:
        raise InputError(
            f"cannot be rewritten as a file of {target.title}; leave --into out",
            source=existing.source,
        )
    text = files[readable[0]].decode("utf-8")
    return {own: existing.encoded(text.replace("\r\n", "\n"))}


def check_existing(existing: TextFile, target: Target) -> None:
    """Refuse a file whose fields cannot be kept.

    Raises:
        InputError: It is not one of the firmware, or not what that writes; with the line.
    """
    if not target.recognise(PurePath(existing.source).name, existing.text):
        raise InputError(
            f"is not a file of {target.title}; name one that it writes",
            source=existing.source,
            line=1,
        )
    read_file(target, existing)


def _recognised(target: Target, name: str, content: bytes) -> bool:
    return target.recognise(name, content.decode("utf-8", "replace"))


def read_back(
    files: Mapping[str, bytes], configuration: Configuration, target: Target, *, whole: bool = True
) -> tuple[str, ...]:
    """Read the files back and hold them against what they were made of.

    Args:
        files: By name.
        configuration: What they were made of.
        target: Whose they are.
        whole: Whether they may say nothing else; false for files with fields of others.

    Returns:
        Names of the files that a reader knows; others (a script beside the file) are not read.

    Raises:
        VerificationError: One of them says something else, or none is known.
    """
    known = _known(files, target)
    names, found = ", ".join(file.source for file in known), together(target, known)
    if not whole:
        alone = target.read_several is not None
        decided = _without(_own(configuration) if alone else configuration, target.of_project)
        if target.one_meaning:
            decided = replace(decided, version=found.version)
        differences = [(names, misread(decided, found))]
    else:
        # A file of several may say less than they do together (one inductance, without the ratio).
        part = _own if len(known) > 1 and target.read_several is not None else _whole
        differences = [
            (file.source, contradicting(part(configuration), part(read_file(target, file))))
            for file in known
        ]
        differences.append((names, differing(configuration, found)))
    for source, difference in differences:
        if difference:
            raise VerificationError(f"{source}: reads back as something else: {difference}")
    return tuple(file.source for file in known)


# Relative difference of values that two ages of a format print with different digits.
_OTHER_DIGITS = 1e-5


def _own(configuration: Configuration) -> Configuration:
    """What a file says by its own names, without what is worked out of several of them: one file
    of several, in which values of others stand, says that only with the others.
    """
    return replace(configuration, drive=DriveValues(), current_d=None, current_q=None, speed=None)


def _without(configuration: Configuration, names: frozenset[str]) -> Configuration:
    own = {key: value for key, value in configuration.own.items() if key not in names}
    return replace(configuration, own=own)


def _whole(configuration: Configuration) -> Configuration:
    return configuration


def _known(files: Mapping[str, bytes], target: Target) -> list[TextFile]:
    """Those of the files that the target's reader knows."""
    decoded = [decoded_file(content, name) for name, content in files.items()]
    known = [file for file in decoded if target.recognise(PurePath(file.source).name, file.text)]
    if not known:
        raise VerificationError(
            f"{', '.join(files)}: the reader of {target.method.name} does not know its own files"
        )
    return known


def read_files(files: Mapping[str, bytes], target: Target) -> Configuration:
    """What the files that a reader knows say together, with the places of the values."""
    return together(target, _known(files, target))


def differing(wanted: Configuration, found: Configuration, *, whole: bool = True) -> str:
    """The first difference of two configurations in what they say, "" where there is none.

    Unless they are held against each other as a whole, the second may say more than the first.
    """
    one, other = _values(wanted), _values(found)
    if not whole:
        one = {key: value for key, value in one.items() if value is not None}
        other = {key: value for key, value in other.items() if key in one}
    for key in [*one, *(key for key in other if key not in one)]:
        if one.get(key) != other.get(key):
            return f"{key} is {other.get(key)}, not {one.get(key)}"
    return ""


def misread(wanted: Configuration, found: Configuration) -> str:
    """The first value that a file with fields of others says differently, "" where there is none.

    Such a file holds the names of its own age alone, so that it may say less. Names of another
    age may stand for other numbers: what they amount to is held against each other then, as
    nearly as their digits allow.
    """
    if wanted.version == found.version:
        return contradicting(wanted, found)
    one, other = _values(replace(wanted, own={})), _values(replace(found, own={}))
    for key, value in one.items():
        read = other.get(key)
        if not isinstance(value, (int, float)) or not isinstance(read, (int, float)):
            continue
        if not math.isclose(value, read, rel_tol=_OTHER_DIGITS):
            return f"{key} is {read}, not {value}"
    return ""


def contradicting(wanted: Configuration, found: Configuration) -> str:
    """The first value that both state, and state differently; "" where there is none."""
    one, other = _values(wanted), _values(found)
    for key, value in one.items():
        if value is not None and other.get(key) is not None and other[key] != value:
            return f"{key} is {other[key]}, not {value}"
    return ""


def _values(configuration: Configuration) -> dict[str, object]:
    """What a configuration says, by name, without where it stands and what is said of it."""
    plain = replace(configuration, own={}, origins={})
    found: dict[str, object] = {
        "firmware": plain.firmware,
        "version": plain.version,
        **{name: getattr(plain.drive, name) for name in plain.drive.__slots__},
    }
    for name in ("current_d", "current_q", "speed"):
        gains = getattr(plain, name)
        found[f"{name}.kp"] = None if gains is None else gains.kp
        found[f"{name}.ki"] = None if gains is None else gains.ki
    return found | {f"own.{key}": value for key, value in configuration.own.items()}


# Configurations and judged loops of firmware as tables, in engineering units.

# Fields of `DriveValues` with their names and units.
FIELDS = (
    ("pole_pairs", "pole pairs", ""),
    ("r_s", "phase resistance", "Ohm"),
    ("l_d", "inductance d", "H"),
    ("l_q", "inductance q", "H"),
    ("psi_pm", "magnet flux linkage", "Wb"),
    ("inertia", "inertia", "kg m^2"),
    ("viscous", "friction", "N m s/rad"),
    ("i_max", "current limit (peak)", "A"),
    ("omega_m_max", "largest speed", "rpm"),
    ("v_dc", "DC link", "V"),
    ("f_sw", "switching frequency", "Hz"),
    ("dead_time", "dead time", "s"),
    ("t_s", "period of the current control", "s"),
    ("t_speed", "period of the speed control", "s"),
    ("shunt", "shunt of the current measurement", "Ohm"),
    ("sense_gain", "its amplifier", ""),
    ("sense_reference", "reference of the converter", "V"),
)

_GAINS = (
    ("current_d", "d current controller", "V/A", "V/(A s)"),
    ("current_q", "q current controller", "V/A", "V/(A s)"),
    ("speed", "speed controller (q current)", "A s/rad", "A/rad"),
)

_LOOPS = (("current_d", "i_d"), ("current_q", "i_q"), ("speed", "speed"))

_COLUMNS = (
    "",
    "crossover Hz",
    "bandwidth Hz",
    "phase margin deg",
    "gain margin dB",
    "delay margin us",
    "M_s",
    "damping",
    "",
)

_SHOWN = {"rad": "deg"}


def value_rows(drive: DriveValues) -> list[tuple[str, str, str]]:
    """Field, name and text of every value that is known."""
    found = []
    for name, label, unit in FIELDS:
        value = getattr(drive, name)
        if value is not None:
            found.append((name, label, format_quantity(float(value), unit) if unit else f"{value}"))
    return found


def _gain_rows(found: Configuration) -> Iterator[tuple[str, str, str]]:
    for name, label, unit_p, unit_i in _GAINS:
        gains: PiGains | None = getattr(found, name)
        if gains is not None:
            yield f"{name}.kp", f"{label}, kp", format_quantity(gains.kp, unit_p)
            yield f"{name}.ki", f"{label}, ki", format_quantity(gains.ki, unit_i)


def configuration_table(found: Configuration, title: str) -> Table:
    """Every value: in SI, as it is written in the file and where, and how it was converted."""
    rows: list[tuple[str, ...]] = []
    shown: set[str] = set()
    for name, label, text in (*value_rows(found.drive), *_gain_rows(found)):
        origin = found.origins.get(name)
        shown.add("" if origin is None else origin.key)
        rows.append((label, text, *_placed(origin)))
    for key, value in found.own.items():
        origin = found.origins.get(key)
        if key in shown or (origin is not None and origin.key in shown):
            continue
        text = f"{value:.9g}" if isinstance(value, float) else str(value)
        file, line, _ = _placed(origin)
        rows.append((key, text, file or text, line, meaning(found.firmware, key)))
    columns = ("", "value", "in the file", "line", "conversion or meaning")
    notes = (
        *(f"convention: {sentence}" for sentence in conventions_here(found)),
        *(f"contradiction: {sentence}" for sentence in found.contradictions),
    )
    return Table(title, columns, tuple(rows), notes)


def _placed(origin: Origin | None) -> tuple[str, str, str]:
    """What stands in the file, its line, and how it was converted."""
    if origin is None:
        return "", "", ""
    line = "" if origin.line is None else str(origin.line)
    return f"{origin.key} {origin.text}".strip(), line, origin.conversion or "as it is"


def loops_table(found: JudgedFirmware, title: str, profile: LoopProfile | None = None) -> Table:
    """Margins of each loop, with the poles of what observes speed and angle."""
    rows = tuple(
        _loop_cells(label, loop)
        for name, label in _LOOPS
        if (loop := getattr(found, name)) is not None
    )
    notes = (*_timing(profile), *_observed(found, profile), *found.remarks)
    return Table(title, _COLUMNS if rows else (), rows, notes)


def _timing(profile: LoopProfile | None) -> Iterator[str]:
    """What the margins are of, where those of dqforge's own control are others."""
    if profile is not None:
        yield (
            f"margins: with this firmware's delay of {profile.current.delay:.3g} periods from the "
            "sampling to its voltage; tune shows those of dqforge's control, 1 period"
        )


def _loop_cells(label: str, loop: JudgedLoop) -> tuple[str, ...]:
    return (
        label,
        _number(loop.crossover / (2.0 * math.pi)),
        _number(loop.bandwidth / (2.0 * math.pi)),
        _number(math.degrees(loop.phase_margin)),
        _number(20.0 * math.log10(loop.gain_margin)),
        _number(1e6 * loop.delay_margin),
        _number(loop.max_sensitivity),
        _number(loop.damping),
        "stable" if loop.stable else "UNSTABLE",
    )


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    text = f"{value:.4g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e7 else text


def _observed(found: JudgedFirmware, profile: LoopProfile | None) -> Iterator[str]:
    if found.pll_poles is not None:
        poles = " and ".join(pole_text(pole) for pole in found.pll_poles)
        yield f"phase-locked loop of the speed: poles at {poles} rad/s"
    observer = None if profile is None else profile.observer
    if observer is not None:
        rate = "" if observer.rate is None else f", errors decay with {observer.rate:.4g} rad/s"
        yield f"position observer: {observer.name}{rate}"
        yield from observer.warnings


def shortfall_table(found: tuple[Shortfall, ...]) -> list[Table]:
    """What the format cannot hold; no table where it holds everything."""
    if not found:
        return []
    rows = tuple((shortfall.words, price_text(shortfall)) for shortfall in found)
    return [Table("what the format cannot hold", ("deviation", "cost"), rows)]


def price_text(shortfall: Shortfall) -> str:
    """What a shortfall costs, in numbers; "" where there are none."""
    texts = []
    for price in shortfall.prices:
        if price.unit:
            unit = _SHOWN.get(price.unit, price.unit)
            texts.append(f"{price.of} {format_quantity(price.value, unit)}")
        else:
            texts.append(f"{price.of} {100.0 * price.value:.3g} %")
    return ", ".join(texts)


def explained_tables(found: Explained, source: str, title: str) -> list[Table]:
    """A file of a firmware, and its loops."""
    runs = f"loops as {found.configuration.firmware} runs them"
    return [
        configuration_table(found.configuration, f"{source}: {title}"),
        loops_table(found.judged, runs, found.profile),
    ]


def own_tables(found: OwnGains, judged: JudgedFirmware, source: str) -> list[Table]:
    """Gains that dqforge wrote, on a machine, and their loops."""
    rows = [(label, text) for _, label, text in value_rows(found.drive)]
    units = (("V/A", "V/(A s)"), ("V/A", "V/(A s)"), ("N m s/rad", "N m/rad"))
    for (name, label), (unit_p, unit_i) in zip(_LOOPS, units, strict=True):
        gains: PiGains | None = getattr(found, name)
        if gains is not None:
            rows.append((f"{label} kp", format_quantity(gains.kp, unit_p)))
            rows.append((f"{label} ki", format_quantity(gains.ki, unit_i)))
    return [
        Table(f"{source}: gains of dqforge", ("", "value"), tuple(rows)),
        loops_table(judged, "loops as the emitted control runs them"),
    ]


def fit_tables(found: FirmwareFit, read: Configuration, title: str) -> list[Table]:
    """What was written for a firmware (as its file reads back), its loops, and what is lost."""
    return [
        configuration_table(read, title),
        loops_table(found.judged, f"loops as {found.name} runs them", found.profile),
        *shortfall_table(found.shortfalls),
    ]


# Configuration files of other firmware as a capability: files, words, tables, and the report.

Fits = tuple[FirmwareFit, ...]

CHAPTER = Chapter("firmware", "Other firmware")


def _of(outcome: Outcome) -> Fits | None:
    return outcome.solution.firmware or None


def _emitted(solution: Solution, fits: Fits) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    for fit in fits:
        files |= firmware_files(solution.design, fit)
    return files


def _plain(solution: Solution, fits: Fits) -> PlainData:
    return {
        fit.name: plain_fit(fit) | {"files": list(firmware_files(solution.design, fit))}
        for fit in fits
    }


def _tables_of(solution: Solution, fit: FirmwareFit) -> list[Table]:
    files, target = firmware_files(solution.design, fit), target_named(fit)
    return fit_tables(fit, read_files(files, target), f"{target.title}: {', '.join(files)}")


def _tables(solution: Solution, fits: Fits) -> list[Table]:
    return [table for fit in fits for table in _tables_of(solution, fit)]


def _summary(solution: Solution, fits: Fits) -> Rows:
    rows: Rows = []
    for fit in fits:
        names = ", ".join(firmware_files(solution.design, fit))
        rows.append((f"for {fit.name}", f"{names}; {_margins(fit)}"))
        rows += [("  cannot hold", shortfall.words) for shortfall in fit.shortfalls]
    return rows


def _margins(fit: FirmwareFit) -> str:
    """Crossover and margin of the q current and of the speed, as that firmware runs them."""
    texts = []
    for name, loop in (("i_q", fit.judged.current_q), ("speed", fit.judged.speed)):
        if loop is not None and math.isfinite(loop.crossover):
            crossover = loop.crossover / (2.0 * math.pi)
            margin = math.degrees(loop.phase_margin)
            texts.append(f"{name} {crossover:.4g} Hz, phase margin {margin:.3g} deg")
    return "; ".join(texts) or "no loop evaluated"


def _html(table: Table, text_columns: int) -> HtmlTable:
    """A table for the report with its notes."""
    rows = tuple(Row(tuple(map(symbols, row))) for row in table.rows)
    columns, notes = tuple(map(symbols, table.columns)), tuple(map(symbols, table.notes))
    return HtmlTable(symbols(table.title), columns, rows, text_columns, notes)


def _passage(solution: Solution, fit: FirmwareFit) -> Passage:
    files, (values, loops, *lost) = firmware_files(solution.design, fit), _tables_of(solution, fit)
    held = _html(replace(values, title=", ".join(files)), len(values.columns))
    rest = [_html(loops, 1), *(_html(table, len(table.columns)) for table in lost)]
    tables = [replace(held, folded=True), *rest]
    return Passage(title=target_named(fit).title, tables=tables, kind="loops words")


def _parts(solution: Solution, fits: Fits) -> list[ReportPart]:
    text = (
        "The same drive under third-party firmware: the contents of the file, the resulting loops, "
        "and the deviations from the design."
    )
    passages = [Passage(text=[text]), *(_passage(solution, fit) for fit in fits)]
    return [passage.of(CHAPTER) for passage in passages]


FIRMWARE = Capability(
    name="firmware",
    title="configuration files of other firmware",
    of=_of,
    plain=_plain,
    always=False,
    summary=_summary,
    tables=_tables,
    parts=_parts,
    emitted=_emitted,
)


# Files of other firmware in an output folder, read back and held against what the design gives.

_WRITTEN = "the folder that 'dqforge run' or 'dqforge export' wrote"


def written_firmware(folder: Path, solution: Solution) -> dict[str, tuple[str, ...]]:
    """By firmware the files in a folder that read back as the configuration of the design.

    Args:
        folder: What 'dqforge run' or 'export' wrote.
        solution: What the design in the folder gives.

    Raises:
        InputError: A file cannot be read, or is not what its firmware writes.
        VerificationError: A file says something else.
    """
    found: dict[str, tuple[str, ...]] = {}
    for fit in solution.firmware:
        names = firmware_files(solution.design, fit)
        contents = {name: read_output(folder / name, _WRITTEN) for name in names}
        found[fit.name] = read_back(contents, fit.configuration, target_named(fit))
    return found


def read_back_text(name: str, files: Sequence[str]) -> str:
    """What was read back, in one line."""
    return f"{name}: {', '.join(files)} read back as the configuration that the design gives"
