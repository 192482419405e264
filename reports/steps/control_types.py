"""Types, angle functions and transforms that the headers of a drive share, in C."""

from __future__ import annotations

from functools import cache

from dqforge.optimizer.steps import angle_functions as angles
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq, Rotation
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import SHARED, vector_struct
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression


@cache
def control_types(prefix: str, macro: str) -> str:
    """What headers have before all else, guarded for those that are included together; needs
    <math.h>.

    Args:
        prefix, macro: Before the names of functions and types, and before that of the guard.
    """
    functions = Functions()
    reader = StepReader(prefix, functions, Block("", set()))
    turn = vector(Rotation, "turn")
    for name, function, arguments in (
        ("wrap", angles.wrap, [Expression("theta")]),
        ("rotation", angles.rotation, [Expression("theta")]),
        ("small_rotation", angles.small_rotation, [Expression("theta")]),
        ("turned", angles.turned, [turn, turn]),
        ("clarke", Arithmetic.clarke, [vector(Abc, "x")]),
        ("clarke_inverse", Arithmetic.clarke_inverse, [vector(AlphaBeta, "x")]),
        ("park", Arithmetic.park, [vector(AlphaBeta, "x"), turn]),
        ("park_inverse", Arithmetic.park_inverse, [vector(Dq, "x"), turn]),
    ):
        reader.write(name, function, arguments)
    guard = f"{macro}_CONTROL_TYPES"
    return "\n\n".join(
        [
            f"#ifndef {guard}\n#define {guard}",
            *("\n".join(vector_struct(kind, prefix)) for kind in SHARED),
            *functions.texts.values(),
            f"#endif /* {guard} */",
        ]
    )
