"""Current references with field weakening in C, written from their step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dqforge.machines.transforms import Reals
from dqforge.optimizer.field_weakening.voltage_region import STEPS, DropReference
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.counted_loops import place
from dqforge.reports.steps.step_reader import Block, Functions, StepReader
from dqforge.reports.steps.symbols import Expression

_SAID = (
    "Current references for a torque within a voltage at a speed, the drop over the phase "
    "resistance included."
)


def weakening_text(reference: DropReference, lines: Sequence[str], prefix: str) -> str:
    """Constants and functions of the header.

    Args:
        reference: What is evaluated.
        lines: What is said of it behind its first sentence.
        prefix: Before the names of functions, in capitals before those of constants.
    """
    macro, surface = f"{prefix.upper()}_WEAKENING", reference.surface
    ends: dict[str, Any] = {
        "flux_min": Expression(f"{macro}_FLUX_MIN_WB"),
        "flux_max": Expression(f"{macro}_FLUX_MAX_WB"),
    }
    named, trials = replace(reference, surface=replace(surface, **ends)), place(f"{macro}_TRIALS")
    functions = Functions()
    reader, number = StepReader(prefix, functions, Block("", set())), Expression("number")

    def weakening_reference(o: Arithmetic, torque: Reals, v_max: Reals, omega_e: Reals) -> Dq:
        return named.step(o, torque, v_max, omega_e, trials)

    reader.write("weakening_limit", named.weakening_limit, [number], names=["flux_Wb"])
    reader.write("weakening_flux", named.weakening_flux, [number, number])
    reader.write("weakening_least_flux", named.weakening_least_flux, [number, number])
    reader.write(
        "weakening_reference",
        weakening_reference,
        [number] * 3,
        into=["i_d_A", "i_q_A"],
        names=["torque_Nm", "v_max_V", "omega_e_rad_per_s"],
    )
    *inner, last = functions.texts.values()
    said = [f"/* {_SAID}", " *", *(f" * {comment_text(line)}".rstrip() for line in lines), " */"]
    least, most = map(float_literal, map(float, (surface.flux_min, surface.flux_max)))
    constants = [
        f"#define {macro}_FLUX_MIN_WB ({least}) /* least available flux linkage, Wb */",
        f"#define {macro}_FLUX_MAX_WB ({most}) /* from here upwards it limits nothing, Wb */",
        f"#define {macro}_TRIALS ({STEPS}U) /* of the torque, where not all of it can be had */",
    ]
    return "\n\n".join(["\n".join(constants), *inner, "\n".join([*said, last])])
