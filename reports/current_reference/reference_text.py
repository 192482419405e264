"""The evaluator of a current reference in C, written from its step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dqforge.machines.transforms import Reals
from dqforge.optimizer.current_reference.forms import CurrentReference, SignedReference
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.step_reader import Functions, StepReader
from dqforge.reports.steps.symbols import Expression

# Names of the ends of the domain, by sign of the torque.
_ENDS = "limit.torque", "limit.torque_negative"
_INTO = "i_d_A", "i_q_A"


def reference_functions(plain: Mapping[str, Any], names: Mapping[str, str], prefix: str) -> str:
    """The evaluator in float32, and one for each sign of the torque where these differ.

    Args:
        plain: What `dqforge.reports.current_reference.plain.to_plain` says of the reference.
        names: Of the ends of its domain, by quantity, without prefix.
        prefix: Before the names of functions, in capitals before those of ends.
    """
    reference, functions = from_plain(plain), Functions()
    reader = StepReader(prefix, functions, Block("", set()))

    def write(name: str, step: Callable[..., Dq]) -> None:
        reader.write(name, step, [Expression("torque")], into=_INTO, names=["torque_Nm"])

    ends = [Expression(f"{prefix.upper()}_{names[end]}") for end in _ENDS if end in names]
    if isinstance(reference, SignedReference):
        signs = reference.steps(*ends)
        for step in signs:
            write(step.__name__, step)

        def current_reference(o: Arithmetic, torque: Reals) -> Dq:
            return reference.by_sign(o, torque, *signs)

    else:
        assert isinstance(reference, CurrentReference)

        def current_reference(o: Arithmetic, torque: Reals) -> Dq:
            return reference.step(o, torque, ends[0])

    write("current_reference", current_reference)
    return "\n\n".join(functions.texts.values())
