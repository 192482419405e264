"""The control of a phase machine in fixed point as C: plain data, header, test vectors."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.fixed_control.step import IDLE
from dqforge.reports.c_code.header_kind import SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.control.fixed_basics import fixed_basics
from dqforge.reports.control.fixed_header import integer_rows, sweep_rows
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.fixed_phase_model import (
    phase_inputs,
    phase_outputs,
    phase_results,
    phase_rows,
)

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit
    from dqforge.optimizer.fixed_phase_control.integers import (
        FixedPhaseControl,
    )
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.plain_data import PlainData

_SEED = 20_261_122


_BASES = (
    ("BASE_CURRENT_A", "A (peak)"),
    ("BASE_VOLTAGE_V", "V (peak of phase)"),
    ("BASE_SPEED_RAD_PER_S", "mechanical speed, rad/s"),
    ("BASE_TORQUE_NM", "N m"),
    ("BASE_FLUX_WB", "back-EMF over electrical speed, V s/rad"),
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
        "sine_error_codes": fit.sine_error,
    }


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


def _speed_comment(control: FixedPhaseControl) -> list[str]:
    if control.speed is None:
        return ["There is no speed loop."]
    return [f"The speed loop runs every {control.ratio} current samples."]


def phase_fixed_context(design: Design, fit: FixedPhaseFit) -> PlainData:
    """Everything that the header prints, as plain data."""
    control, bits = fit.control, fit.control.width - 1
    scales = [
        {"name": name, "value": value, "comment": text}
        for (name, text), value in zip(_BASES, control.bases, strict=True)
    ]
    link = control.bases[1] * 2.0**control.dc_scale
    scales.append({"name": "BASE_DC_VOLTAGE_V", "value": link, "comment": "V, of the dc link"})
    return {
        **title(design),
        **fixed_basics(control.turn, fit.sine_error),
        "control": control,
        "idle": asdict(IDLE),
        "loops": {},
        "loops_comment": _speed_comment(control),
        "reference": False,
        "rule": TOPOLOGIES[control.topology],
        "legs": TOPOLOGIES[control.topology].legs,
        "preamble": _preamble(fit, design),
        "scales": scales,
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
    inputs = phase_rows(control, sweep_rows(control.width), SWEEP_SEED)
    results = phase_results(control, inputs)
    return integer_rows(control.width, inputs, results, "fixed-point control of the phases")
