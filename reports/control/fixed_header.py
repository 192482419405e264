"""The control functions in fixed point as C: plain data, header, test vectors,
the way back from ``result.json``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from typing import Any, get_args

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.optimizer.fixed_control.arithmetic import Integers
from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.optimizer.fixed_control.gains import FixedGain
from dqforge.optimizer.fixed_control.ranges import control_ranges
from dqforge.optimizer.fixed_control.step import (
    FixedControl,
    FixedDecoupling,
    FixedObserver,
    FixedPi,
    PiForm,
)
from dqforge.optimizer.fixed_control.transforms import (
    full_scale,
    rotation,
    sine_steps,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.control.fixed_model import input_names, output_names, row_inputs, row_results
from dqforge.reports.observers.speed_loop_text import margin_words
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData

_SEED = 20_261_121


_LOOP_NAMES = {"i_d": "ID", "i_q": "IQ", "speed": "SPEED"}


_FAULT = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def plain_fixed_control(control: FixedControl) -> PlainData:
    """The integers as plain data."""
    return asdict(control)


def fixed_control_from(plain: Mapping[str, Any], width: int) -> FixedControl:
    """Read control functions in words of ``width`` bits back, and prove again that nothing
    overflows.

    Raises
    ------
    InputError
        The data are not what `plain_fixed_control` makes.
    """
    try:
        found = FixedControl(
            width=_one_of(plain["width"], (width,)),
            bases=_bases(plain["bases"]),
            modulation=_one_of(
                plain["modulation"],
                tuple(name for name in MODULATORS if MODULATORS[name].in_integers),
            ),
            dc_scale=_whole(plain["dc_scale"], 0, 8),
            dc_least=_whole(plain["dc_least"], 1, full_scale(width)),
            limit=_gain(plain["limit"], width),
            advance=_gain(plain["advance"], width),
            i_d=_forms(plain["i_d"], width),
            i_q=_forms(plain["i_q"], width),
            speed=None if plain["speed"] is None else _forms(plain["speed"], width),
            decoupling=FixedDecoupling(
                **{k: _gain(v, width) for k, v in plain["decoupling"].items()}
            ),
            observer=None if plain["observer"] is None else _observer(plain["observer"], width),
        )
        control_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, NoSolutionError):
        raise _FAULT from None
    return found


def _one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    if isinstance(value, bool) or value not in choices:
        raise ValueError(value)
    return value


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def _bases(value: Any) -> tuple[float, float, float, float]:
    current, voltage, speed, torque = (_real(entry) for entry in value)
    if not min(current, voltage, speed, torque) > 0.0:
        raise ValueError(value)
    return current, voltage, speed, torque


def _gain(plain: Mapping[str, Any], width: int) -> FixedGain:
    top = full_scale(width)
    return FixedGain(
        _whole(plain["mantissa"], -top, top),
        _whole(plain["shift"], 0, 2 * width - 2),
        _real(plain["value"]),
    )


def _forms(plain: Mapping[str, Any], width: int) -> dict[PiForm, FixedPi]:
    return {
        form: FixedPi(
            **{name: _gain(plain[form][name], width) for name in ("kp", "ki", "tracking")},
            fraction=_whole(plain[form]["fraction"], 0, width - 1),
        )
        for form in get_args(PiForm)
    }


def _observer(plain: Mapping[str, Any], width: int) -> FixedObserver:
    gains = {name: _gain(plain[name], width) for name in ("decay", "b_u", "b_i", "c", "x_d")}
    return FixedObserver(
        **gains,
        fraction=_whole(plain["fraction"], 0, width - 1),
        reach=_whole(plain["reach"], 1, 2 ** (width - 1)),
    )


@cache
def sine_error(width: int) -> float:
    """Largest error of sine and cosine in codes: of all angles in 16 bits,
    of 200,000 in 32 bits.
    """
    angle = (
        np.arange(65_536)
        if width == 16
        else np.random.default_rng(_SEED).integers(0, 2**32, 200_000)
    )
    turn, one = rotation(Integers(), width, angle), 2.0 ** (width - 1)
    exact = angle * (2.0 * math.pi / 2.0**width)
    return float(
        max(
            np.max(np.abs(turn.x - one * np.cos(exact))),
            np.max(np.abs(turn.y - one * np.sin(exact))),
        )
    )


def _scales(control: FixedControl) -> list[PlainData]:
    current, voltage, speed, torque = control.bases
    values = {
        "BASE_CURRENT_A": (current, "A (peak)"),
        "BASE_VOLTAGE_V": (voltage, "V (peak of phase)"),
        "BASE_DC_VOLTAGE_V": (voltage * 2.0**control.dc_scale, "V, of the dc link"),
        "BASE_SPEED_RAD_PER_S": (speed, "mechanical speed, rad/s"),
        "BASE_TORQUE_NM": (torque, "N m, output of the speed controller"),
    }
    return [
        {"name": name, "value": value, "comment": text} for name, (value, text) in values.items()
    ]


def _loops_comment(fit: FixedControlFit) -> list[str]:
    """What rounding does to each loop, and what moves its integral."""
    lines = []
    for name, loop in fit.loops.items():
        margins = [math.degrees(found.phase_margin) for found in (loop.exact, loop.found)]
        lines.append(
            f"{name}: kp {loop.kp.text()} ({loop.kp.error:+.2e}), ki t_s {loop.ki_ts.text()} "
            f"({loop.ki_ts.error:+.2e});"
        )
        if loop.exact.observed is None:
            lines.append(
                f"  phase margin {margins[0]:.2f} deg with real gains, {margins[1]:.2f} deg with "
                "these;"
            )
        else:
            lines.append(
                f"  phase margin with real gains and the observer's lag {margin_words(loop.exact)} "
                "deg;"
            )
        band = fit.dead_bands.get(name)
        lines.append(
            f"  the smallest error that moves the integral is {band.largest} codes."
            if band
            else "  no integral."
        )
    return lines


def _preamble(fit: FixedControlFit, design: Design) -> list[str]:
    control, fullest, bits, period = (
        fit.control,
        fit.fullest,
        fit.control.width,
        1e6 * design.control.t_s,
    )
    least = control.dc_least / 2 ** (control.width - 1) * control.bases[1] * 2.0**control.dc_scale
    return [
        (
            f"{design.machine.pole_pairs} pole pairs, sampled every {period:.6g} us, "
            f"{control.modulation}."
        ),
        (
            f"Codes are int{bits}_t, 2^{bits - 1} of them full scale; angles uint{bits}_t, "
            f"2^{bits} a turn."
        ),
        (
            "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign "
            "(checked below)."
        ),
        (
            f"No overflow for any inputs and any past: {len(fit.reaches)} products and sums proven "
            "by interval analysis;"
        ),
        f"the fullest, '{fullest.name}', reaches {fullest.share:.4%} of int{2 * control.width}_t.",
        (
            "That holds for the gains below and errors of two codes; limits passed to functions "
            "are 0 to full scale."
        ),
        "Currents beyond full scale must be saturated where they are measured;",
        f"a dc link below {least:.4g} V counts as that.",
    ]


def control_fixed_context(design: Design, fit: FixedControlFit) -> PlainData:
    """Everything that the header prints, as plain data."""
    control, bits = fit.control, fit.control.width - 1
    error = rounded_up(sine_error(control.width))
    found = "exhaustive" if control.width == 16 else "sampled"
    return {
        **title(design),
        "format": control.format,
        "width": control.width,
        "top": full_scale(control.width),
        "preamble": _preamble(fit, design),
        "scales": _scales(control),
        "sine": asdict(sine_steps(control.width)),
        "sine_error": f"; error at most {error} codes ({found})",
        "third": round(2**bits / 3),
        "inverse_root": round(2**bits / math.sqrt(3.0)),
        "half_root": round(2**bits * math.sqrt(0.75)),
        "two_thirds": round(2**bits * 2 / 3),
        "modulator": MODULATORS[control.modulation],
        "third_share": round(2**bits * 4 * MODULATORS[control.modulation].share),
        "dc_scale": control.dc_scale,
        "dc_least": control.dc_least,
        "limit": asdict(control.limit),
        "advance": asdict(control.advance),
        "loops": {
            _LOOP_NAMES[k]: {f: asdict(pi) for f, pi in forms.items()}
            for k, forms in control.loops.items()
        },
        "loop_names": {name: _LOOP_NAMES[name] for name in control.loops},
        "loops_comment": _loops_comment(fit),
        "decoupling": asdict(control.decoupling),
        "observer": None if control.observer is None else asdict(control.observer),
        "zeta_max": 0 if control.observer is None else _zeta_max(control.observer, control.width),
    }


def _zeta_max(observer: FixedObserver, width: int) -> int:
    return observer.reach * full_scale(width) << observer.fraction


def control_fixed_files(design: Design, fit: FixedControlFit) -> dict[str, bytes]:
    """Names and bytes of the header of control functions in one fixed-point format,
    and of its test vectors.
    """
    context, control = control_fixed_context(design, fit), fit.control
    inputs = row_inputs(control, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, row_results(control, inputs)], axis=1).tolist()
    columns = {"inputs": input_names(control), "outputs": output_names(control), "vectors": vectors}
    name = f"{design.export.prefix}_control_{control.format}"
    texts = {
        f"{name}.h": render("control/fixed.h.j2", context),
        f"{name}_vectors.h": render("control/fixed_vectors.h.j2", context | columns),
    }
    return {file: text.encode("ascii") for file, text in texts.items()}


def plain_fixed_evidence(fit: FixedControlFit) -> PlainData:
    """Loops with their integers, the proven range of every product and sum, and the dead bands,
    as plain data.
    """
    loops = {}
    for name, loop in fit.loops.items():
        integers = {part: asdict(getattr(loop, part)) for part in ("kp", "ki_ts", "q0", "q1")}
        band = fit.dead_bands.get(name)
        loops[name] = integers | {
            "kp_error": loop.kp.error,
            "ki_ts_error": loop.ki_ts.error,
            "velocity_ki_error": loop.velocity_ki_error,
            "phase_margin_rad": loop.found.phase_margin if loop.exact.observed is None else None,
            "poles": [[z.real, z.imag] for z in loop.found.poles.tolist()]
            if loop.exact.observed is None
            else None,
            "dead_band_codes": None if band is None else band.largest,
        }
    ranges = [
        {"name": reach.name, "low": reach.range.low, "high": reach.range.high, "bits": reach.bits}
        for reach in fit.reaches
    ]
    return {"loops": loops, "ranges": ranges, "sine_error_codes": sine_error(fit.control.width)}


def control_fixed_programme(control: FixedControl) -> Programme:
    """In 16 bits as many rows as there are angles, so that each comes once."""
    inputs = row_inputs(control, 2**16 if control.width == 16 else SWEEP_POINTS, SWEEP_SEED)
    wide = np.dtype(f"i{control.width // 4}")
    context = {"width": control.width, "format": control.format}
    results = row_results(control, inputs).astype(wide)
    return Programme(
        "control/fixed_harness.c.j2",
        inputs.astype(wide),
        results,
        context,
        name="fixed-point control",
    )


def plain_fixed(solution: Solution) -> PlainData:
    """Control functions in fixed point with their evidence; nothing where none are asked for."""
    if not solution.fixed:
        return {}
    evidence = {fit.control.format: plain_fixed_evidence(fit) for fit in solution.fixed}
    headers = {
        f"control_{fit.control.format}_header": plain_fixed_control(fit.control)
        for fit in solution.fixed
    }
    return {"control_fixed": evidence} | headers
