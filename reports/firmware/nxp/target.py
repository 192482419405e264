"""Headers of MCAT written: whole, or into a project's own one, which keeps everything else."""

from __future__ import annotations

import json
import re
from decimal import ROUND_HALF_UP, Decimal
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import (
    FLAGS,
    INPUTS,
    MACROS,
    PROJECT_INPUTS,
    PROJECT_MACROS,
    SPELLINGS,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import McatFile
from dqforge.optimizer.firmware.targets.nxp import NXP
from dqforge.reports.firmware.c_macros import read_macros, with_values
from dqforge.reports.firmware.json_text import JsonText, with_json_values
from dqforge.reports.firmware.nxp.reader import (
    line_inputs,
    motor_of,
    objects,
    read,
    read_file,
    recognise,
    with_inputs,
)
from dqforge.reports.firmware.target import Target
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


_EXISTING = "existing file"

_BEFORE_USER = re.compile(r"^[ \t]*/\* USER INPUT START \*/", re.MULTILINE)


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``m1_pmsm_appconfig.h``, or that of the motor of an existing file.

    Args:
        found: The configuration.
        title: What stands at its head.
        existing_text: A header of the project, whose macros, comments and user's lines stay; the
            constants are made for its age. None for a new one.

    Raises:
        InputError: The existing file is that of another arithmetic, or none of MCAT.
    """
    file = McatFile.of(found)
    if existing_text is None:
        return {"m1_pmsm_appconfig.h": _anew(file, title).encode("utf-8")}
    theirs = read_file(existing_text, _EXISTING)
    if theirs.edition.fixed != file.edition.fixed:
        ours = "fixed point" if file.edition.fixed else "float"
        raise InputError(
            f"the existing header is not one of a {ours} build, as the design asks for; name one "
            f"that is, or give or leave out control.current_loop.q_formats",
            source=_EXISTING,
        )
    prefix = motor_of(existing_text) or "M1_"
    file = file.in_edition(theirs.edition.version).in_project(theirs)
    text = _merged(file, prefix, existing_text)
    return {f"{prefix.lower()}pmsm_appconfig.h": text.encode("utf-8")}


def _anew(file: McatFile, title: FileTitle) -> str:
    sections = [
        (section, [(macro, _text(file, macro)) for macro in macros if macro in file.own])
        for section, macros in MACROS.items()
    ]
    values = {
        section: {key: _value(key, file.own[key]) for key in keys if key in file.own}
        for section, keys in INPUTS.items()
    }
    motor = {"motorName": file.name, "motorDescription": f"made by dqforge {title.version}"}
    context = {
        "title": title,
        "version": file.edition.version,
        "file": "m1_pmsm_appconfig.h",
        "prefix": "M1_",
        "inputs": _json(values),
        "motor": _json(motor),
        "sections": sections,
    }
    return render("firmware/nxp/m1_pmsm_appconfig.h.j2", context)


def _text(file: McatFile, macro: str) -> str:
    return constant_text(float(file.own[macro]), file.kind(macro), commented=file.edition.commented)


def _value(key: str, value: OwnValue) -> OwnValue:
    """An input as JSON holds it: flags as such, whole numbers without a point."""
    if key in FLAGS:
        return bool(value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _json(values: object) -> str:
    """As MCAT's own reader takes it, and without what would end a comment."""
    return json.dumps(values, indent=4, ensure_ascii=True).replace("/", "\\u002f")


def _merged(file: McatFile, prefix: str, text: str) -> str:
    text = _with_comments(file, text)
    macros = read_macros(text, _EXISTING)
    texts = {
        prefix + macro.removeprefix("M1_"): _text(file, macro)
        for group in MACROS.values()
        for macro in group
        if macro in file.own
    }
    changed = with_values(text, macros, texts)
    missing = "".join(
        f"#define {macro} {value}\n" for macro, value in texts.items() if macro not in macros
    )
    if not missing:
        return changed
    user = _BEFORE_USER.search(changed)
    place = user.start() if user else changed.rfind("#endif")
    place = len(changed) if place < 0 else place
    return f"{changed[:place]}{missing}{changed[place:]}"


def _with_comments(file: McatFile, text: str) -> str:
    """The text with the inputs in its comments changed where they stand."""
    held = with_inputs(objects(text, _EXISTING))
    if held is not None:
        inside = with_json_values(text[held.start : held.end], _EXISTING, _changes(file, held.json))
        return text[: held.start] + inside + text[held.end :]
    lines = text.split("\n")
    for part in line_inputs(text, _EXISTING):
        value = file.own.get(part.key)
        if value is not None and not isinstance(value, str):
            line = lines[part.line - 1]
            head, sign, tail = line.partition("=")
            lines[part.line - 1] = head + sign + tail.replace(part.text, plain(value), 1)
    return "\n".join(lines)


def _changes(file: McatFile, json_text: JsonText) -> dict[tuple[str, ...], OwnValue]:
    """Values of the inputs that stand there already, by path."""
    changes: dict[tuple[str, ...], OwnValue] = {}
    spelled = {ours: theirs for theirs, ours in SPELLINGS.items()}
    for section, keys in INPUTS.items():
        there = json_text.value(section)
        if not isinstance(there, dict):
            continue
        for key in keys:
            name = key if key in there else spelled.get(key, key)
            value = file.own.get(key)
            if key == "parametersKt" and value is None and file.edition.current_share != 1.0:
                value = file.own.get("parametersKe")
            if name in there and value is not None:
                changes[section, name] = _value(key, value)
    return changes


# NXP's motor control among the firmware whose files are written and read.

TARGET = Target(
    NXP,
    "NXP motor control (MCAT: m1_pmsm_appconfig.h, 2016 to 2026)",
    write,
    recognise,
    read,
    of_project=frozenset(PROJECT_INPUTS + PROJECT_MACROS),
)


# Numbers as MCAT's headers print them.

DIGITS = 6


def constant_text(value: float, kind: str, *, commented: bool) -> str:
    """The text behind a macro.

    Args:
        value: Its number.
        kind: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``.
        commented: Whether it is that of the older age, which prints all digits.
    """
    if kind == "plain":
        return f"({plain(value)})"
    text = _all_digits(value) if commented else six_digits(value)
    return f"({text}F)" if kind == "float" else f"{kind}({text})"


def six_digits(value: float) -> str:
    """As it is with fewer than six decimal places, else with six significant digits."""
    if value == int(value):
        return f"{value:.1f}"
    exact = Decimal(repr(value))
    exponent = exact.as_tuple().exponent
    if isinstance(exponent, int) and -exponent < DIGITS:
        return f"{exact:f}"
    step = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    return f"{Decimal(value).quantize(step, rounding=ROUND_HALF_UP):f}"


def plain(value: float | bool) -> str:
    """A number without exponent, whole ones without a point; true or false."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not value.is_integer():
        return f"{Decimal(repr(value)):f}"
    return str(int(value))


def _all_digits(value: float) -> str:
    return f"{value:.1f}" if value == int(value) else f"{Decimal(repr(value)):f}"
