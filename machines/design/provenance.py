"""Where the values of a design come from, and what was taken for granted."""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.machines.design.values import InputValue
from dqforge.machines.entries.kinds import Section, quantities
from dqforge.machines.places import dotted
from dqforge.machines.units.quantities import format_quantity

_ALTERNATIVE = {
    "phase": "write kind: line-to-line if it was measured between two terminals",
    "peak": "write kind: rms if it is an r.m.s. value",
    "line-to-line peak": "write kind: line-to-line rms, phase peak or phase rms otherwise",
}


_SHOWN = {"speed": "rpm"}


_WHAT = {
    "phase": "a phase value",
    "peak": "a peak value",
    "line-to-line peak": "rpm per volt between two terminals at its peak, as that of hobby motors",
}


def input_values(
    file: Section, converted: Mapping[str, tuple[float, str]]
) -> tuple[InputValue, ...]:
    """Each quantity of the file with its origin.

    Args:
        file: The file's content.
        converted: For the paths of values that were converted: the value that is used, in SI units,
            and what was done.
    """
    values = []
    for parts, quantity in quantities(file):
        path = dotted(parts)
        si, conversion = converted.get(path, (quantity.si, ""))
        kind = f" ({quantity.kind})" if quantity.kind and quantity.kind_given else ""
        note = "; ".join(text for text in (conversion, quantity.note) if text)
        values.append(
            InputValue(
                path,
                quantity.text + kind,
                si,
                quantity.unit,
                quantity.source,
                quantity.inferred,
                note,
            )
        )
    return tuple(values)


def kind_assumptions(file: Section) -> tuple[str, ...]:
    """Sentences on conventions that the file does not name, and on values
    that it marks as inferred.
    """
    sentences = []
    for parts, quantity in quantities(file):
        path = dotted(parts)
        if quantity.remark:
            used = (
                f", {format_quantity(quantity.si, _SHOWN.get(quantity.dimension, quantity.unit))}"
            )
            sentences.append(f"{path}: {quantity.remark}{used}")
        if quantity.kind is not None and not quantity.kind_given and quantity.si != 0.0:
            what, otherwise = _WHAT[quantity.kind], _ALTERNATIVE[quantity.kind]
            sentences.append(f"{path} is taken as {what}; {otherwise}")
        if quantity.inferred:
            reason = quantity.note or quantity.source or "no reason is given"
            sentences.append(f"{path} is inferred: {reason}")
    return tuple(sentences)
