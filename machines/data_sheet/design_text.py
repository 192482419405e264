"""The design file of a data sheet: every value with the convention that it was read in, what was
assumed marked as inferred, what was not given as a comment with what it is for.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping

from dqforge.machines.data_sheet.sheet_values import (
    SHEET_VALUES,
    SheetValue,
    assumed_frequency,
    is_needless,
)
from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.files.yaml_edit import written
from dqforge.machines.units.quantities import parse_quantity

DEFAULT_NAME = "My drive"

_WIDTH = 100
_COLUMN = 44
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?")

_HEAD = """\
# The design of a drive from its data sheet. A value is a number with a unit and, where data sheets
# differ, its convention; "# used:" says what became of it.
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
    yield from _entries("machine.", values, used)
    yield "\ninverter:\n"
    yield from _entries("inverter.", values, used)
    yield _INVERTER
    yield _LOOPS
    yield _SPEED_LOOP if "machine.inertia" in values else _NO_SPEED_LOOP
    yield _END


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
