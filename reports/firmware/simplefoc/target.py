"""SimpleFOC's motor written: a header with one function, and lines of the Commander."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.simplefoc_format import LOOP_PERIOD, MEMBERS, SIGNIFICANT, V_DC
from dqforge.optimizer.firmware.targets.simplefoc import SIMPLEFOC
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.firmware.c_macros import with_values
from dqforge.reports.firmware.simplefoc.reader import (
    CONSTRUCTOR,
    ENUMERATORS,
    VOLTAGES,
    Sketch,
    is_script,
    read,
    recognise,
    script,
    sketch_of,
)
from dqforge.reports.firmware.target import Target, c_float
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


_EXISTING = "existing file"


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_simplefoc.h`` and ``<prefix>_simplefoc.txt``.

    Args:
        found: The configuration.
        title: What stands at the head of the header, and shortened of the script.
        existing_text: A sketch, a header or a script whose other lines are to stay; None without
            one. The other one of the two files is written anew.
    """
    own = found.own
    as_script = existing_text is not None and is_script(existing_text)
    header = _header(own, title)
    if existing_text is not None and not as_script:
        header = _in_sketch(own, sketch_of(existing_text, _EXISTING))
    lines = script(own, title, existing_text if as_script else None)
    return {
        f"{title.prefix}_simplefoc.h": header.encode("utf-8"),
        f"{title.prefix}_simplefoc.txt": lines.encode("utf-8"),
    }


def literal(name: str, value: OwnValue) -> str:
    """A value in C++: an enumerator, a whole number, or a single-precision number."""
    if name in ENUMERATORS:
        return ENUMERATORS[name][int(value)]
    return c_float(value, SIGNIFICANT) if isinstance(value, float) else str(value)


def _header(own: Mapping[str, OwnValue], title: FileTitle) -> str:
    members = [
        (name, "v_max" if name in VOLTAGES else literal(name, own[name]), member.says)
        for name, member in MEMBERS.items()
        if name in own
    ]
    macro = title.prefix.upper()
    context = {
        "title": title,
        "macro": macro,
        "v_dc": literal(V_DC, own[V_DC]) if V_DC in own else None,
        "period": literal(LOOP_PERIOD, own[LOOP_PERIOD]) if LOOP_PERIOD in own else None,
        "arguments": ", ".join(literal(name, own[name]) for name in CONSTRUCTOR if name in own),
        "members": members,
        "inductance": literal("axis_inductance.q", own["axis_inductance.q"]),
    }
    return render("firmware/simplefoc/motor.h.j2", context)


def _in_sketch(own: Mapping[str, OwnValue], sketch: Sketch) -> str:
    """The sketch with the values where it sets them; what it does not set stands behind the last
    of them, or else behind the constructor.
    """
    wanted = {name: literal(name, own[name]) for name in MEMBERS if name in own}
    values, last = {}, None
    for definition in sketch.assignments.every:
        member = sketch.member(definition)
        if member in wanted:
            values[definition.name] = wanted[member]
            last = definition
    missing = [
        name
        for name in wanted
        if not any(sketch.member(one) == name for one in sketch.assignments.every)
    ]
    text = with_values(sketch.text, sketch.assignments, values)
    if last is None or not missing:
        return text
    lines = text.split("\n")
    at = last.line
    while at < len(lines) and ";" not in lines[at - 1]:
        at += 1
    before = lines[last.line - 1]
    indent = before[: len(before) - len(before.lstrip())]
    added = [
        f"{indent}{sketch.motor}.{name} = {wanted[name]}; // {comment_text(MEMBERS[name].says)}"
        for name in missing
    ]
    return "\n".join((*lines[:at], *added, *lines[at:]))


# SimpleFOC among the firmware whose files are written and read.

TARGET = Target(SIMPLEFOC, "SimpleFOC (Arduino-FOC 2.4)", write, recognise, read)
