"""The control of a phase machine in fixed point as C: plain data and back, header, test vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, get_args

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.fixed_control.transforms import sine_error, sine_steps
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedMidpoint,
    FixedPhaseControl,
)
from dqforge.optimizer.fixed_phase_control.phase_ranges import phase_ranges
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.fixed_phase_model import (
    phase_inputs,
    phase_outputs,
    phase_results,
    phase_rows,
)
from dqforge.reports.plain_data import PlainData

_SEED = 20_261_122


_BASES = (
    ("BASE_CURRENT_A", "A (peak)"),
    ("BASE_VOLTAGE_V", "V (peak of phase)"),
    ("BASE_SPEED_RAD_PER_S", "mechanical speed, rad/s"),
    ("BASE_TORQUE_NM", "N m"),
    ("BASE_FLUX_WB", "back-EMF over electrical speed, V s/rad"),
)


_FAULT = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def plain_phase_integers(control: FixedPhaseControl) -> PlainData:
    """The integers as plain data."""
    return asdict(control)


def plain_phase_evidence(fit: FixedPhaseFit) -> PlainData:
    """Proven range of every product and sum, and the error of the shape, as plain data."""
    return {
        "ranges": [
            {
                "name": reach.name,
                "low": reach.range.low,
                "high": reach.range.high,
                "bits": reach.bits,
            }
            for reach in fit.reaches
        ],
        "fullest": {"name": fit.fullest.name, "share": fit.fullest.share},
        "shape_error": fit.shape_error,
        "sine_error_codes": sine_error(fit.control.width),
    }


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _one_of(value: Any, words: Any) -> Any:
    if value not in get_args(words):
        raise ValueError(value)
    return value


def _gain(plain: Mapping[str, Any], width: int) -> FixedGain:
    top, value = 2 ** (width - 1) - 1, plain["value"]
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    shift = _whole(plain["shift"], 0, 2 * width - 2)
    return FixedGain(_whole(plain["mantissa"], -top, top), shift, float(value))


def _axis(plain: Mapping[str, Any], width: int) -> FixedAxis:
    names = ("kp", "ki", "resistance", "inductance", "reactance")
    return FixedAxis(
        **{name: _gain(plain[name], width) for name in names},
        fraction=_whole(plain["fraction"], 0, width - 1),
    )


def _harmonic(plain: Mapping[str, Any], width: int) -> FixedHarmonic:
    return FixedHarmonic(
        order=_whole(plain["order"], -99, 99),
        zero=bool(plain["zero"]),
        reactance=_gain(plain["reactance"], width),
        fade=_gain(plain["fade"], width),
        end=_whole(plain["end"], 1, 2 << width),
    )


def _shape(plain: Any, width: int) -> tuple[tuple[int, ...], ...]:
    top = 2 ** (width - 1) - 1
    rows = tuple(tuple(_whole(value, -top, top) for value in row) for row in plain)
    sizes = {len(row) for row in rows}
    if len(rows) not in (1, 3) or len(sizes) != 1 or not 25 <= sizes.pop() <= 2**14:
        raise ValueError(len(rows))
    return rows


def _bases(plain: Any) -> tuple[float, float, float, float, float]:
    current, voltage, speed, torque, flux = (float(value) for value in plain)
    if not all(0.0 < value < math.inf for value in (current, voltage, speed, torque, flux)):
        raise ValueError(plain)
    return current, voltage, speed, torque, flux


def phase_integers_from(plain: Mapping[str, Any], width: int) -> FixedPhaseControl:
    """Read the control in words of ``width`` bits back, and prove again that nothing overflows.

    Raises
    ------
    InputError
        The data are not what `plain_phase_integers` makes.
    """
    code = 2 ** (width - 1)
    gains = ("fade", "unit", "sample", "electrical", "rate")
    middle = plain.get("midpoint")
    try:
        found = FixedPhaseControl(
            **{name: _gain(plain[name], width) for name in gains},
            width=_whole(plain["width"], width, width),
            bases=_bases(plain["bases"]),
            frame=_one_of(plain["frame"], CurrentFrame),
            feedforward=_one_of(plain["feedforward"], Feedforward),
            topology=_one_of(plain["topology"], Topology),
            shape=_shape(plain["shape"], width),
            turns=_whole(plain["turns"], 1, 200),
            fundamental=_whole(plain["fundamental"], -code + 1, code - 1),
            fade_end=_whole(plain["fade_end"], 0, 4 * code),
            unit_bits=_whole(plain["unit_bits"], 0, width - 1),
            least_square=_whole(plain["least_square"], 1, 4 * code),
            d=_axis(plain["d"], width),
            q=_axis(plain["q"], width),
            zero=None if plain["zero"] is None else _axis(plain["zero"], width),
            harmonic_fraction=_whole(plain["harmonic_fraction"], 0, width - 1),
            error_max=_whole(plain["error_max"], 0, 16 * code),
            harmonics=tuple(_harmonic(part, width) for part in plain["harmonics"]),
            midpoint=None
            if middle is None
            else FixedMidpoint(_gain(middle["balance"], width), _gain(middle["fade"], width)),
            dc_scale=_whole(plain["dc_scale"], 0, 8),
            dc_least=_whole(plain["dc_least"], 1, code - 1),
        )
        phase_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, NoSolutionError):
        raise _FAULT from None
    return found


def _preamble(fit: FixedPhaseFit, design: Design) -> list[str]:
    control, bits, fullest = fit.control, fit.control.width, fit.fullest
    return [
        (
            f"Frame {control.frame}, {control.topology}; sampled every "
            f"{1e6 * design.control.t_s:.6g} us."
        ),
        (
            f"Codes are int{bits}_t, 2^{bits - 1} of them full scale; the angle is uint{bits}_t, "
            f"2^{bits} the shape's period."
        ),
        "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign.",
        (
            f"No overflow for any inputs and any past: {len(fit.reaches)} products and sums proven "
            "by interval analysis;"
        ),
        f"the fullest, '{fullest.name}', reaches {fullest.share:.4%} of int{2 * bits}_t.",
        "Currents beyond full scale must be saturated where they are measured.",
    ]


def phase_fixed_context(design: Design, fit: FixedPhaseFit) -> PlainData:
    """Everything that the header prints, as plain data."""
    control, bits = fit.control, fit.control.width - 1
    scales = [
        {"name": name, "value": value, "comment": text}
        for (name, text), value in zip(_BASES, control.bases, strict=True)
    ]
    link = control.bases[1] * 2.0**control.dc_scale
    scales.append({"name": "BASE_DC_VOLTAGE_V", "value": link, "comment": "V, of the dc link"})
    found = "exhaustive" if control.width == 16 else "sampled"
    return {
        **title(design),
        "format": control.format,
        "width": control.width,
        "top": control.top,
        "control": control,
        "rule": TOPOLOGIES[control.topology],
        "legs": TOPOLOGIES[control.topology].legs,
        "preamble": _preamble(fit, design),
        "scales": scales,
        "sine": asdict(sine_steps(control.width)),
        "sine_error": f"; error at most {rounded_up(sine_error(control.width))} codes ({found})",
        "third": round(2**bits / 3),
        "inverse_root": round(2**bits / math.sqrt(3.0)),
        "half_root": round(2**bits * math.sqrt(0.75)),
        "root_half": round(2**bits * math.sqrt(0.5)),
    }


def phase_fixed_files(design: Design, fit: FixedPhaseFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    context, control = phase_fixed_context(design, fit), fit.control
    inputs = phase_rows(control, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, phase_results(control, inputs)], axis=1).tolist()
    columns = {
        "inputs": phase_inputs(control),
        "outputs": phase_outputs(control),
        "vectors": vectors,
    }
    name = f"{design.export.prefix}_control_{control.format}"
    texts = {
        f"{name}.h": render("phase_control/fixed_phase.h.j2", context),
        f"{name}_vectors.h": render("phase_control/fixed_vectors.h.j2", context | columns),
    }
    return {file: text.encode("ascii") for file, text in texts.items()}


def phase_fixed_programme(control: FixedPhaseControl) -> Programme:
    """In 16 bits as many rows as there are angles, so that each comes once."""
    inputs = phase_rows(control, 2**16 if control.width == 16 else SWEEP_POINTS, SWEEP_SEED)
    wide = np.dtype(f"i{control.width // 4}")
    context = {"width": control.width, "format": control.format}
    results = phase_results(control, inputs).astype(wide)
    return Programme(
        "control/fixed_harness.c.j2",
        inputs.astype(wide),
        results,
        context,
        name="fixed-point control of the phases",
    )
