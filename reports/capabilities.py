"""The headers that a design may ask for beside that of its current reference,
each with its way back from the result.

A header is described in ``result.json`` under ``<name>_header``; what stands there alone rebuilds
the model that its compiled functions must equal.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dqforge.machines.errors import InputError
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import FurtherHeader
from dqforge.reports.control.fixed_header import control_fixed_programme
from dqforge.reports.control.fixed_reading import fixed_control_from
from dqforge.reports.control.header import control_from, control_programme
from dqforge.reports.field_weakening.header import (
    weakening_from,
    weakening_programme,
)
from dqforge.reports.loops.header import evaluator_from, gains_programme
from dqforge.reports.modulation_choice.header import rule_programme
from dqforge.reports.modulation_choice.rule_model import emitted_from
from dqforge.reports.observers.position_header import (
    observer_from,
    observer_programme,
)
from dqforge.reports.observers.speed_float32_model import speed_observer_from
from dqforge.reports.observers.speed_header import speed_observer_programme
from dqforge.reports.waveforms.float32_model import phase_reference_from
from dqforge.reports.waveforms.header import waveform_programme

FURTHER_HEADERS = (
    FurtherHeader("waveform", lambda own, _: phase_reference_from(own), waveform_programme),
    FurtherHeader("weakening", lambda own, _: weakening_from(own), weakening_programme),
    FurtherHeader("modulation", lambda own, _: emitted_from(own), rule_programme),
    FurtherHeader("gains", lambda own, _: evaluator_from(own), gains_programme),
    FurtherHeader("observer", lambda own, _: observer_from(own), observer_programme, vectors=False),
    FurtherHeader(
        "speed_observer",
        lambda own, _: speed_observer_from(own),
        speed_observer_programme,
        vectors=False,
    ),
    FurtherHeader("control", control_from, control_programme, vectors=False),
    FurtherHeader(
        "control_q15", lambda own, _: fixed_control_from(own, 16), control_fixed_programme
    ),
    FurtherHeader(
        "control_q31", lambda own, _: fixed_control_from(own, 32), control_fixed_programme
    ),
)

"""All kinds, in the order in which they are written and verified."""


def programmes(plain: Mapping[str, Any]) -> tuple[dict[str, FurtherHeader], list[Programme]]:
    """The further headers that a result describes by name, and their harnesses.

    Raises
    ------
    InputError
        What stands there is not what dqforge writes.
    """
    found = {}
    made = []
    for kind in FURTHER_HEADERS:
        described = plain.get(kind.key)
        if described is None:
            continue
        if not isinstance(described, dict):
            raise InputError(f"{kind.key} is not what dqforge writes; run the design again")
        found[kind.name] = kind
        made.append(kind.programme(kind.read(described, plain)))
    return found, made
