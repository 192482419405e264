"""The six-step control in C, written from its steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

from dqforge.optimizer.six_step import control, sector_step
from dqforge.optimizer.six_step.control import FAULTS, STAGES, SixStep, SixStepGains, SixStepLegs
from dqforge.optimizer.six_step.sector_step import BlockGains, BlockState, SixStepSeen
from dqforge.optimizer.steps.step_arithmetic import Abc
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.record_text import record_structs, record_values, vector_struct
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import Functions, StepReader
from dqforge.reports.steps.symbols import Expression


@dataclass(frozen=True, slots=True)
class ZeroCrossingGains(BlockGains):
    """Numbers of the estimator; those with two entries hold forwards and backwards."""


@dataclass(slots=True)
class ZeroCrossing(BlockState):
    """What the estimator keeps from sample to sample."""


@dataclass(frozen=True, slots=True)
class EmfIntegrationGains(BlockGains):
    """Numbers of the estimator; those with two entries hold forwards and backwards."""


@dataclass(slots=True)
class EmfIntegration(BlockState):
    """What the estimator keeps from sample to sample."""


# What the records of the estimator are called in C, by its name there.
_KINDS: dict[str, tuple[type[BlockGains], type[BlockState]]] = {
    "zero_crossing": (ZeroCrossingGains, ZeroCrossing),
    "emf_integration": (EmfIntegrationGains, EmfIntegration),
}


def _named(kind: type[Any], record: Any) -> Any:
    """A record as one of another name."""
    return kind(*(getattr(record, field.name) for field in fields(record)))


def control_text(code: str, gains: SixStepGains, prefix: str, macro: str) -> str:
    """What stands in the header behind the types that all headers share.

    Args:
        code: Name of the estimator in C.
        gains: Of the control.
        prefix, macro: Before the names of functions and types, and before those of macros.
    """
    own, kept = _KINDS[code]
    gains = replace(gains, observer=_named(own, gains.observer))
    blank = control.blank()
    state = replace(blank, observer=_named(kept, blank.observer))
    functions = _functions(code, gains, state, prefix)
    known = set[str]()
    parts = [
        *_enumerations(macro),
        *_tables(macro),
        *record_structs(gains, prefix, known=known),
        *record_structs(state, prefix, known=known),
        vector_struct(SixStepLegs, prefix),
        vector_struct(SixStepSeen, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {prefix}_six_step_gains_t {macro}_SIX_STEP_GAINS = {{",
            *record_values(gains, None),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def _functions(code: str, gains: SixStepGains, state: SixStep, prefix: str) -> Functions:
    names = {name: f"{code}_{name}" for name in ("crossing", "see", "due")}
    names |= {f"block_{name}": f"{code}_{name}" for name in ("start", "step")}
    functions = Functions(names=names)
    reader = StepReader(prefix, functions, Block("", set()))
    number, v, i = Expression("number"), vector(Abc, "v"), vector(Abc, "i")
    start = [gains.observer, state.observer, 0, 1, number, number]
    reader.write(f"{code}_start", sector_step.block_start, start)
    reader.write(f"{code}_step", sector_step.block_step, [gains.observer, state.observer, v])
    reader.write("six_step_reset", control.six_step_reset, [gains, state])
    speed, torque = control.six_step_speed_control, control.six_step_torque_control
    reader.write("six_step_speed_control", speed, [gains, state, number])
    reader.write("six_step_torque_control", torque, [state, number])
    reader.write("six_step_step", control.six_step_step, [gains, state, v, i, number])
    return functions


def _enumerations(macro: str) -> Iterator[list[str]]:
    for begin, names in (("", STAGES), ("FAULT_", FAULTS)):
        values = [
            f"    {macro}_SIX_STEP_{begin}{name.upper().replace(' ', '_')} = {n}"
            for n, name in enumerate(names)
        ]
        yield [
            "/* Faults. */" if begin else "/* Stages. */",
            "enum {",
            *",\n".join(values).split("\n"),
            "};",
        ]


def _tables(macro: str) -> Iterator[list[str]]:
    """Phases by sector."""
    yield ["/* Phases by sector: fed, returning, floating. */"] + [
        f"static const int32_t {macro}_{name}[6] = {{ {', '.join(map(str, table))} }};"
        for name, table in sector_step.TABLES.items()
    ]
