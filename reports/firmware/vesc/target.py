"""VESC's motor configuration written: XML that VESC Tool merges, and a header of the same keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.targets.vesc import VESC
from dqforge.optimizer.firmware.vesc_format import KEYS, SIGNIFICANT
from dqforge.reports.firmware.c_macros import read_macros, with_texts, with_values
from dqforge.reports.firmware.target import Target, number_text
from dqforge.reports.firmware.vesc.reader import FORMER, define, is_xml, read, recognise
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


_EXISTING = "existing file"

# Limits that a file keeps where it allows less.
OF_PROJECT = ("l_current_min", "l_abs_current_max")


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_mcconf.xml`` and ``<prefix>_mcconf.h``.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: What stands at the head of the files.
        existing_text: XML or header whose other values and comments are to stay; None without one.
            The other one of the two files is written anew.
    """
    own = found.own if existing_text is None else _as_careful(found.own, existing_text)
    values = {name: printed(value) for name in KEYS if (value := own.get(name)) is not None}
    context = {
        "title": title,
        "guard": f"{title.prefix.upper()}_MCCONF_H_",
        "values": [(name, define(name), text, KEYS[name].says) for name, text in values.items()],
    }
    xml = render("firmware/vesc/mcconf.xml.j2", context)
    header = render("firmware/vesc/mcconf.h.j2", context)
    if existing_text is not None and is_xml(existing_text):
        xml = with_texts(existing_text, _EXISTING, _as_named_in_xml(values, existing_text))
    elif existing_text is not None:
        header = _with_macros(existing_text, values)
    return {
        f"{title.prefix}_mcconf.xml": xml.encode("utf-8"),
        f"{title.prefix}_mcconf.h": header.encode("utf-8"),
    }


def _as_careful(own: Mapping[str, OwnValue], text: str) -> dict[str, OwnValue]:
    """The values with the limit of braking and the trip of an existing file where they allow less:
    the battery and the board decide them as well.
    """
    kept = dict(own)
    try:
        theirs = read(text, _EXISTING).own
    except InputError:  # A value without a number limits nothing.
        return kept
    for name in OF_PROJECT:
        one, other, largest = own.get(name), theirs.get(name), own.get("l_current_max")
        if not all(isinstance(value, float) for value in (one, other, largest)):
            continue
        less = 0.0 < abs(float(other or 0.0)) < abs(float(one or 0.0))
        if less and (name == "l_current_min" or float(other or 0.0) > float(largest or 0.0)):
            kept[name] = float(other or 0.0)
    return kept


def printed(value: OwnValue) -> str:
    """A value as VESC Tool prints it."""
    return number_text(value, SIGNIFICANT)


def _as_named_in_xml(values: dict[str, str], text: str) -> dict[str, str]:
    """The values by the names that the text uses: those of older versions where it has them."""
    former = {new: old for old, new in FORMER.items() if f"<{old}>" in text}
    return {former.get(name, name): value for name, value in values.items()}


def _with_macros(text: str, values: dict[str, str]) -> str:
    """The header with other texts behind its macros; those that it has not stand before its end."""
    macros = read_macros(text, _EXISTING)
    former = {new: define(old) for old, new in FORMER.items() if define(old) in macros}
    named = {former.get(name, define(name)): value for name, value in values.items()}
    changed = with_values(text, macros, named)
    missing = "".join(
        f"#define {name} {value}\n" for name, value in named.items() if name not in macros
    )
    if not missing:
        return changed
    head, end, tail = changed.rpartition("#endif")
    guarded = end and macros.every and macros.every[0].text == ""
    return f"{head}{missing}\n{end}{tail}" if guarded else f"{changed.rstrip()}\n\n{missing}"


# VESC among the firmware whose files are written and read.

TARGET = Target(
    VESC,
    "VESC (bldc firmware and VESC Tool, parameters of 7.01)",
    write,
    recognise,
    read,
    of_project=frozenset(OF_PROJECT),
    one_meaning=True,
)
