"""What a reader of designs says of the values of a data sheet: of each by itself, and of those that
are known so far together.
"""

from __future__ import annotations

import copy
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.catalogue import (
    Override,
    build_design,
    overridden,
    parse_design,
    put,
    read_sections,
    value_at,
)
from dqforge.machines.design.design import Design, Reading
from dqforge.machines.design.plausibility import implausibilities
from dqforge.machines.design.plausible_figures import MARK
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sheet_values import (
    BY_KEY,
    FLUX_AXES,
    FLUX_MAP,
    MAP_FLAGS,
    SHEET_VALUES,
    SheetValue,
    assumed_frequency,
    is_needless,
    missing,
)
from dqforge.machines.entries.former_keys import text_with_present_names
from dqforge.machines.entries.kinds import quantities
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.errors import InputError, KeyPath, dotted, leading_path
from dqforge.machines.files.positioned_yaml import (
    YamlDocument,
    YamlValue,
    edited,
    parse_yaml,
    written,
)
from dqforge.machines.units.quantities import format_quantity, parse_quantity, refuse_bare

_SOURCE = "design.yaml"

# By its need, what stands in for what is not known yet; no sentence is told of it.
_STAND_INS = {
    "poles": ("machine.pole_pairs", "4"),
    "magnets": ("machine.magnet_flux", "10 mWb"),
    "voltage": ("inverter.v_dc", "48 V"),
    "current": ("machine.max_current", "10 A"),
    "resistance": ("machine.resistance", "0.1 Ohm"),
}

# Needs without which the reader does not look at the others.
_ALONE = ("voltage", "current", "resistance")
_TIME_CONSTANT = 1e-3  # Inductance over resistance (s) where the inductance is not known yet.


def read_alone(key: str, text: str) -> Quantity | None:
    """A value as the reader of designs has it, whatever the others are.

    None for the name, which is no quantity.

    Raises:
        InputError: It is none for its key; the message is the reader's own.
    """
    _refuse_bare(BY_KEY[key], text, BY_KEY[key].label)
    values = dict(_STAND_INS[need] for need in _ALONE) | {key: text}
    sections = read_sections(_document(values, design_text(values)))
    found = {dotted(path): quantity for path, quantity in quantities(sections)}
    return found.get(key)


def _refuse_bare(value: SheetValue, text: str, name: str) -> None:
    """Refuse a number without its unit: a file holds numbers in SI units, a data sheet does not."""
    if not value.dimension:
        return
    try:
        refuse_bare(text, value.dimension, kinds=True)
    except InputError as error:
        raise InputError(error.message, source=name) from None


def remarks_so_far(values: Mapping[str, str]) -> list[str]:
    """Sentences on what is implausible in values that are known so far.

    Args:
        values: By the dotted key, each accepted by `read_alone`.

    Raises:
        InputError: Two contradict each other, or together they are no machine.
    """
    open_needs = {value.need for value in missing(values)}
    if open_needs:
        # Ratings are held against the whole machine, so they wait for it.
        parts = {key: text for key, text in values.items() if BY_KEY[key].need}
        file, design = _built(parts | _stand_ins(values, open_needs))
        found = implausibilities(design, file)
        return [sentence for sentence in found if _is_of_known(sentence, values)]
    file, design = _built(values)
    sentences = implausibilities(design, file)
    machine = design.machine
    if machine.omega_m_max is not None:
        fastest = machine.omega_m_max
        warning = datasheet.back_emf_warning(
            machine.pole_pairs, machine.psi_pm, fastest, design.inverter.v_dc
        )
        sentences += [warning] if warning else []
    return sentences


def _stand_ins(values: Mapping[str, str], needs: Collection[str]) -> dict[str, str]:
    found = dict(_STAND_INS[need] for need in needs if need in _STAND_INS)
    if "inductance" in needs:
        resistance = {"machine.resistance": "0.1 Ohm"} | dict(values)
        read = read_alone("machine.resistance", resistance["machine.resistance"])
        assert read is not None
        phase = datasheet.phase_resistance(read.si, read.kind or "phase")
        axes = ("machine.inductance_d", "machine.inductance_q")
        found |= {key: repr(_TIME_CONSTANT * phase) for key in axes if key not in values}
    return found


_DROP = {"machine.resistance", "machine.max_current", "inverter.v_dc"}


_POLES = ("machine.pole_pairs", "machine.poles")


def _is_of_known(sentence: str, known: Collection[str]) -> bool:
    """Whether all that a sentence is made of is known: of figures that is the drop over the
    resistance, and the number of pole pairs.
    """
    key = dotted(leading_path(sentence.removeprefix(MARK)))
    return key in _POLES or (key == "machine.resistance" and set(known) >= _DROP)


def replaced(
    text: bytes, source: str, values: Mapping[str, str], settings: Sequence[str]
) -> tuple[str, list[str]]:
    """The text of a design with the values of a data sheet in the place of its own, and sentences
    on what they replace: other ways to state the same go.

    Args:
        text: The design file.
        source: Its name, for messages.
        values: By the dotted key, what the data sheet says.
        settings: Further keys, as those of ``--set``.

    Raises:
        InputError: A value is none for its key, or a setting is not understood.
    """
    plain = text_with_present_names(text.decode("utf-8-sig"), parse_design(text, source))
    said = []
    for key, typed in values.items():
        value = BY_KEY[key]
        _refuse_bare(value, typed, value.flag)
        ways = (way for way in SHEET_VALUES if value.need and way.need == value.need)
        for other in (key, *(way.key for way in ways if _excludes(key, way.key, values))):
            data = parse_design(plain.encode(), source).data
            if (old := value_at(data, tuple(other.split(".")))) is not None:
                shown_old = old.get("value") if isinstance(old, dict) else old
                said.append(f"{value.flag} {typed!r} replaces {other}: {shown_old} of {source}")
                plain = plain if other == key else _without(plain, data, other)
        data = parse_design(plain.encode(), source).data
        changed = copy.deepcopy(data)
        put(changed, Override(tuple(key.split(".")), as_yaml(key, typed), value.flag))
        plain = edited(plain, data, changed)
    if settings:
        _, plain = overridden(parse_design(plain.encode(), source), plain, settings)
    return plain, said


def _excludes(key: str, other: str, values: Mapping[str, str]) -> bool:
    """Whether a value takes the place of another key that is not given too: the inductances of the
    two axes stand beside each other.
    """
    axes = {"machine.inductance_d", "machine.inductance_q"}
    return other not in values and other != key and not {key, other} <= axes


def _without(text: str, data: dict[str, YamlValue], key: str) -> str:
    """A text without a key: its line goes, where it has one of its own."""
    *sections, last = key.split(".")
    wanted = copy.deepcopy(data)
    around = value_at(wanted, tuple(sections))
    assert isinstance(around, dict)
    del around[last]
    for line in re.finditer(rf"^[ ]+{last}:.*\n", text, re.MULTILINE):
        found = text[: line.start()] + text[line.end() :]
        with suppress(InputError):
            if parse_yaml(found.encode(), "").data == wanted:
                return found
    return edited(text, data, wanted)


def checked_text(
    values: Mapping[str, str],
    folder: Path | None = None,
    origins: Mapping[str, str] | None = None,
    settings: Sequence[str] = (),
) -> str:
    """Text of the design file of a data sheet, which has passed the checks of every design.

    Args:
        values: By the dotted key, what the data sheet says.
        folder: Where the flux map lies, if there is one.
        origins: By the dotted key, where a value comes from that is on no data sheet.
        settings: Further keys of the design, as those of ``--set``.

    Raises:
        InputError: Something is missing, wrong or contradictory; the message names the option.
    """
    for key in values.keys() & BY_KEY.keys():
        _refuse_bare(BY_KEY[key], values[key], BY_KEY[key].flag)
    lacking = missing({*values, *(each.partition("=")[0].strip() for each in settings)})
    if lacking:
        also = " ".join(f"{value.flag} {_quoted(value.example)}" for value in lacking)
        raise InputError(f"a design needs more of the data sheet; give {also} as well")
    _, plain = _built(values, flags=True, folder=folder, settings=settings)
    text = design_text(values, _used(plain) | dict(origins or {}))
    _built(values, text, flags=True, folder=folder, settings=settings)
    return overridden(parse_yaml(text.encode("utf-8"), _SOURCE), text, settings)[1]


def _quoted(text: str) -> str:
    return f'"{text}"' if " " in text else text


def _used(design: Design) -> dict[str, str]:
    """By the dotted key, what the design makes of a value that was converted, or takes it for."""
    found = {}
    for value in design.values:
        if value.path in BY_KEY and value.note and not value.inferred:
            unit = "rpm" if value.unit == "rad/s" else value.unit
            found[value.path] = f"used: {format_quantity(value.si, unit)}; {value.note}"
    for sentence in design.assumptions:
        key, taken, _ = sentence.partition(" is taken as ")
        if taken and key in BY_KEY and key not in found:
            found[key] = sentence.removeprefix(f"{key} is ")
    return found


def _built(
    values: Mapping[str, str],
    text: str = "",
    *,
    flags: bool = False,
    folder: Path | None = None,
    settings: Sequence[str] = (),
) -> tuple[DesignFile, Design]:
    text = text or design_text(values)
    document = _document(values, text, flags=flags)
    if settings:
        own = document.options
        document, text = overridden(document, text, settings)
        document = replace(document, options=own | document.options)
    file = read_sections(document)
    return file, build_design(file, Reading(document, text.encode("utf-8"), folder))


def _document(values: Mapping[str, str], text: str, *, flags: bool = False) -> YamlDocument:
    """What a text holds; its values count as set by options, or by their names, for messages."""
    options: dict[KeyPath, str] = {
        tuple(value.key.split(".")): value.flag if flags else value.label
        for value in SHEET_VALUES
        if value.key in values
    }
    options.update(
        (tuple(key.split(".")), flag) for key, flag in MAP_FLAGS.items() if key in values
    )
    return replace(parse_yaml(text.encode("utf-8"), _SOURCE), options=options)


# The design file of a data sheet: every value with the convention that it was read in, what was
# assumed marked as inferred, what was not given as a comment with what it is for.

DEFAULT_NAME = "My drive"

_WIDTH = 100
_COLUMN = 44
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?")

_HEAD = """\
# The design of a drive from its data sheet. A value is a number with a unit and, where data sheets
# differ, its convention; "# used:" shows the value in use.
#
#   dqforge check design.yaml      what was read, converted and assumed
#   dqforge tune design.yaml       gains and their margins
#   dqforge run design.yaml        header, test vectors and report
#
# A line behind '#' is not read: it shows what may be added, and what for.
dqforge: 1
"""

_INVERTER = """\
  # dead_time: 0.5 us                       # less voltage, and more loss; 0 without it
  # max_current: 60 A                       # of the inverter, where it is the smaller one
"""

_LOOPS = """\

control:
  current_loop:
    method: magnitude-optimum               # or bandwidth, with e.g. bandwidth: 500 Hz
"""

# Not the fastest loop that the sampling permits: firmware of others filters its speed, and
# oscillates on that one (VESC's phase-locked loop is done at some 150 Hz).
_SPEED_LOOP = """\
  speed_loop:                               # possible, since the inertia is known
    method: bandwidth
    bandwidth: 20 Hz                        # calm; symmetrical-optimum is as fast as samples permit
    ratio: 10                               # every tenth sample of the currents
"""

_NO_SPEED_LOOP = """\
  # speed_loop: {method: bandwidth, bandwidth: 20 Hz}   # needs machine.inertia
"""

_END = """\
  # observer: {method: flux, bandwidth: 100 Hz}   # position without an encoder

export:
  prefix: motor                             # begins every name in the generated code
  # control: float32                        # the whole control as C functions; or q15, q31
"""


def design_text(values: Mapping[str, str], used: Mapping[str, str] | None = None) -> str:
    """Text of the design file.

    Args:
        values: By the dotted key, what the data sheet says.
        used: By the dotted key, what a design made of it, for the comments.

    Raises:
        InputError: Never: what is wrong in a value is for the reader of the design to say.
    """
    return "".join(_parts(values, used or {}))


def _parts(values: Mapping[str, str], used: Mapping[str, str]) -> Iterator[str]:
    yield _HEAD
    yield f"name: {written(values.get('name') or DEFAULT_NAME)}\n"
    yield "\nmachine:\n"
    yield _map_entry(values)
    yield from _entries("machine.", values, used)
    yield "\ninverter:\n"
    yield from _entries("inverter.", values, used)
    yield _INVERTER
    yield _LOOPS
    yield _SPEED_LOOP if "machine.inertia" in values else _NO_SPEED_LOOP
    yield _END


_MAP = """\
  model: flux-map
  # Flux linkages over the currents, from the file beside this one. Axes: magnet-d where d lies
  # along the magnets, reluctance where they lie on the negative q axis.
"""


def _map_entry(values: Mapping[str, str]) -> str:
    if FLUX_MAP not in values:
        return ""
    entry: dict[str, YamlValue] = {"file": values[FLUX_MAP]}
    if FLUX_AXES in values:
        entry["axes"] = values[FLUX_AXES]
    return f"{_MAP}  flux_map: {written(entry)}\n"


def _entries(section: str, values: Mapping[str, str], used: Mapping[str, str]) -> Iterator[str]:
    rated = [value for value in SHEET_VALUES if value.key.startswith("machine.rated.")]
    plate_done = False
    for value in SHEET_VALUES:
        if not value.key.startswith(section):
            continue
        if value in rated:
            if not plate_done:
                yield from _name_plate(rated, values, used)
            plate_done = True
        elif value.key in values:
            yield from _given(value, values[value.key], used.get(value.key, ""))
        elif value.key == "inverter.switching_frequency":
            yield _assumed(value, values)
        elif value.use and not is_needless(value, values):
            yield _open(value, "  # ")


def _given(value: SheetValue, text: str, used: str, indent: str = "  ") -> Iterator[str]:
    """What a value is and how it is read, above it; what became of it behind it."""
    if value.convention:
        yield textwrap.fill(
            value.convention,
            _WIDTH,
            initial_indent=f"{indent}# ",
            subsequent_indent=f"{indent}# ",
        )
        yield "\n"
    line = f"{indent}{value.key.rpartition('.')[2]}: {written(as_yaml(value.key, text))}"
    remark = f"# {used or value.use}" if used or value.use else ""
    yield f"{line:{_COLUMN - 1}} {remark}".rstrip() + "\n"


def frequency_for(values: Mapping[str, str]) -> tuple[str, str]:
    """Switching frequency that is assumed for what is known, and why."""
    try:
        v_dc: float | None = parse_quantity(values.get("inverter.v_dc", ""), "voltage")
    except InputError:
        v_dc = None
    return assumed_frequency(v_dc)


def _assumed(value: SheetValue, values: Mapping[str, str]) -> str:
    text, note = frequency_for(values)
    entry: dict[str, YamlValue] = {"value": text, "inferred": True, "note": note}
    return f"  {value.key.rpartition('.')[2]}: {written(entry)}\n"


def _open(value: SheetValue, lead: str) -> str:
    line = f"{lead}{value.key.rpartition('.')[2]}: {value.example}"
    return f"{line:{_COLUMN - 1}} # {value.use or value.what.lower()}\n"


def _name_plate(
    rated: list[SheetValue], values: Mapping[str, str], used: Mapping[str, str]
) -> Iterator[str]:
    known = any(value.key in values for value in rated)
    yield "  rated:\n" if known else "  # rated:\n"
    for value in rated:
        if value.key in values:
            yield from _given(value, values[value.key], used.get(value.key, ""), "    ")
        else:
            yield _open(value, "    # " if known else "  #   ")


def as_yaml(key: str, text: str) -> YamlValue:
    """What is typed for a key, as YAML has it: a number where it is nothing else, else a text."""
    text = text.strip()
    if key == "name" or _NUMBER.fullmatch(text) is None:
        return text
    return int(text) if text.lstrip("+-").isdigit() else float(text)
