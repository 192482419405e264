"""The C header of a six-step drive, as plain data and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.names import SIX_STEP_METHODS
from dqforge.machines.records import dataclass
from dqforge.optimizer.six_step.control import FAULTS, STAGES, SixStepGains
from dqforge.optimizer.six_step.estimator import BlockGains
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.six_step.float32_model import six_step_inputs, six_step_outputs

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.six_step.design import SixStepDesign

_WHOLE = ("by_integral", "ratio", "align", "settle", "gap")


@dataclass(frozen=True, slots=True)
class EmittedSixStep:
    """What verification needs: the method and its gains, float32 values."""

    method: str
    gains: SixStepGains


def code_of(method: str) -> str:
    """Part of C names of a method.

    Args:
        method: As in the design file.
    """
    return method.replace("-", "_")


def _single(value: Any) -> Any:
    if isinstance(value, tuple):
        return [shortest(np.float32(item)) for item in value]
    return shortest(np.float32(value))


def plain_six_step(design: SixStepDesign) -> PlainData:
    """Method and gains as plain data; every number but the whole ones is a float32 value.

    Args:
        design: The six-step drive.
    """
    gains: dict[str, Any] = {
        "observer": {
            field.name: value if field.name in _WHOLE else _single(value)
            for field in fields(BlockGains)
            if (value := getattr(design.gains.observer, field.name)) is not None
        }
    }
    for field in fields(SixStepGains):
        value = getattr(design.gains, field.name)
        if field.name != "observer":
            gains[field.name] = value if field.name in _WHOLE else _single(value)
    return {"method": design.method, "gains": gains}


def _read(kind: type[Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for field in fields(kind):
        value = plain[field.name]
        if field.name == "observer":
            values[field.name] = BlockGains(**_read(BlockGains, value))
        elif field.name in _WHOLE:
            values[field.name] = int(value)
        elif isinstance(value, list):
            values[field.name] = tuple(_finite(item) for item in value)
        else:
            values[field.name] = _finite(value)
    return values


def _finite(value: Any) -> float:
    number = float(np.float32(value))
    if not math.isfinite(number):
        raise ValueError(value)
    return number


def six_step_from(plain: Mapping[str, Any]) -> EmittedSixStep:
    """Read a header back.

    Args:
        plain: What `plain_six_step` makes.

    Raises:
        InputError: It is something else.
    """
    foreign = "six_step_header is not what dqforge writes; run the design again"
    try:
        gains = SixStepGains(**_read(SixStepGains, plain["gains"]))
        method = str(plain["method"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(foreign) from error
    whole = min(gains.align, gains.settle, gains.gap, gains.ratio)
    if method not in SIX_STEP_METHODS or len(gains.observer.crossings) != 6 or whole < 1:
        raise InputError(foreign)
    return EmittedSixStep(method, gains)


def range_text(found: SixStepDesign) -> str:
    """The speeds at which it holds, in words.

    Args:
        found: The six-step drive.
    """
    low, high = found.limits.low, found.limits.high
    return (
        f"from {low / (2.0 * math.pi):.3g} to {high / (2.0 * math.pi):.3g} Hz (electrical), where "
        "a commutation errs by at most 10 deg"
    )


def _preamble(design: Design, found: SixStepDesign) -> list[str]:
    prefix, start = design.export.prefix, found.start
    what = (
        "the integral of its back-EMF" if found.by_integral else "the zero crossing of its back-EMF"
    )
    period = found.gains.observer.t_s * 1e6
    return [
        f"Blocks of 120 degrees, commutated by {what}, every {period:.6g} us.",
        *wrap(f"Range: {range_text(found)}.", 110),
        *wrap(
            f"Start: {start.align_time:.3g} s of alignment and {start.ramp_time:.3g} s of ramp "
            f"with {start.current:.4g} A, against at most {start.load:.4g} N m.",
            110,
        ),
        "",
        *wrap(
            f"{prefix}_six_step_reset() once; in every period {prefix}_six_step_speed_control() or "
            f"{prefix}_six_step_torque_control(), then {prefix}_six_step_step() with the voltages "
            "of the terminals and the currents sampled in the middle of the on-time; the legs it "
            "returns act from the next period on.",
            110,
        ),
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def six_step_files(design: Design, found: SixStepDesign) -> dict[str, bytes]:
    """Name and bytes of the header.

    Args:
        design: What it is of.
        found: Its six-step drive.
    """
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "preamble": _preamble(design, found),
        "code": code_of(found.method),
        "gains": asdict(found.gains),
        "names": [field.name for field in fields(SixStepGains) if field.name != "observer"],
        "whole": _WHOLE,
        "stages": STAGES,
        "faults": FAULTS,
    }
    text = render("six_step/six_step.h.j2", context)
    return {f"{prefix}_six_step.h": text.encode("ascii")}


def six_step_programme(emitted: EmittedSixStep) -> Programme:
    """The harness of a six-step drive, with what its model answers.

    Args:
        emitted: Its method and gains.
    """
    inputs = six_step_inputs(emitted.gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = six_step_outputs(emitted.gains, inputs)
    return Programme("six_step/harness.c.j2", inputs, outputs, name="six-step control")
