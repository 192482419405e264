"""The control functions in fixed point as C: plain data, header, test vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.optimizer.fixed_control.transforms import FixedControl
from dqforge.optimizer.steps.integer_arithmetic import CodeArray
from dqforge.reports.c_code.harness import SWEEP_POINTS, SWEEP_SEED, Harness, Programme, title
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.control.fixed_model import input_names, output_names, row_inputs, row_results
from dqforge.reports.control.fixed_text import control_text, duties_type, pi_text
from dqforge.reports.observers.speed_loop_text import margin_words
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.steps.code_text import code_basics, code_shortening, code_types

_SEED = 20_261_121


_LOOP_NAMES = {"i_d": "ID", "i_q": "IQ", "speed": "SPEED"}


def plain_fixed_control(control: FixedControl) -> PlainData:
    """The integers as plain data; of a reference, that there is one (it stands in its own
    header).
    """
    return asdict(replace(control, reference=None)) | {"reference": control.reference is not None}


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
            f"  the smallest error that moves the integral is {band.largest} codes, "
            f"{fit.physical_band(name):.3g} {'rad/s' if name == 'speed' else 'A'}."
            if band
            else "  no integral."
        )
    torque = fit.control.one_code[3]
    if "speed" in fit.loops:
        lines.append(
            f"speed filter: the smallest change that moves it is {fit.filter_band:.3g} rad/s; "
            f"torque comes in steps of {torque:.3g} N m."
        )
    if fit.observer_band is not None:
        lines.append(
            f"speed observer: its state no longer decays below {fit.observer_band:.3g} rad/s."
        )
    return lines


def _preamble(fit: FixedControlFit, design: Design) -> list[str]:
    control, fullest, bits, period = (
        fit.control,
        fit.fullest,
        fit.control.width,
        1e6 * design.control.t_s,
    )
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
        f"a dc link below {control.dc_least_voltage:.4g} V counts as that.",
    ]


def control_fixed_context(design: Design, fit: FixedControlFit) -> PlainData:
    """Everything that the header prints, as plain data."""
    control = fit.control
    prefix, macro = design.export.prefix, title(design)["macro"]
    loops = {_LOOP_NAMES[name]: forms for name, forms in control.loops.items()}
    return {
        **title(design),
        "subject": "current control",
        "format": control.format,
        "width": control.width,
        "preamble": _preamble(fit, design),
        "scales": _scales(control),
        "parts": [
            code_types(prefix, macro, control.width),
            duties_type(prefix, control.width),
            code_basics(prefix, macro, control.width, error_words(control.width, fit.sine_error)),
            code_shortening(prefix, macro, control.width),
            pi_text(prefix, macro, control.width, loops, _loops_comment(fit)),
            control_text(control, prefix, macro),
        ],
        "reference": control.reference is not None,
        "loop_names": {name: _LOOP_NAMES[name] for name in control.loops},
        "observer": control.observer is not None,
    }


def control_fixed_files(design: Design, fit: FixedControlFit) -> dict[str, bytes]:
    """Names and bytes of the header of control functions in one fixed-point format,
    and of its test vectors.
    """
    context, control = control_fixed_context(design, fit), fit.control
    inputs = row_inputs(control, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, row_results(control, inputs)], axis=1)
    text = render("control/fixed.h.j2", context)
    return control_fixed_harness(control).files(design, text, vectors)


def control_fixed_harness(control: FixedControl) -> Harness:
    """Every function once."""
    rows = IntegerRows(control.width, input_names(control), output_names(control))
    f, number, gains = control.format, rows.number, f"&@@_CONTROL_GAINS_{control.format.upper()}"
    taken, put = rows.taken, rows.put
    turned = f"{{ {taken('x')}, {taken('y')} }}"
    body = [
        f"const @_dq_{f}_t reference = {{ {taken('ref_d')}, {taken('ref_q')} }};",
        f"const @_alphabeta_{f}_t vector = {turned};",
        f"const @_dq_{f}_t turned = {turned};",
        f"@_measured_{f}_t measured;",
        f"@_rotation_{f}_t turn;",
        f"@_alphabeta_{f}_t fixed;",
        f"@_abc_{f}_t phases;",
        f"@_dq_{f}_t moving;",
        f"@_feedforward_{f}_t feed;",
        f"@_pi_{f}_t pi;",
        f"@_pi_velocity_{f}_t velocity;",
        f"@_control_{f}_t control;",
        f"@_duties_{f}_t duty;",
        *([f"@_reduced_order_{f}_t observer;"] if control.observer else []),
        "",
        *(f"measured.i.{x} = {taken(f'i_{x}')};" for x in "abc"),
        f"measured.theta_e = (u{number}){rows.arg('theta')};",
        f"measured.omega_m = {taken('omega')};",
        f"measured.v_dc = {taken('v_dc')};",
        f"turn = @_rotation_{f}(measured.theta_e);",
        put("cosine", "turn.cosine"),
        put("sine", "turn.sine"),
        f"fixed = @_clarke_{f}(measured.i);",
        *(put(f"clarke_{x}", f"fixed.{x}") for x in ("alpha", "beta")),
        f"phases = @_clarke_inverse_{f}(vector);",
        *(put(f"inverse_{x}", f"phases.{x}") for x in "abc"),
        f"moving = @_park_{f}(vector, turn);",
        *(put(f"park_{x}", f"moving.{x}") for x in "dq"),
        f"fixed = @_park_inverse_{f}(turned, turn);",
        *(put(f"back_{x}", f"fixed.{x}") for x in ("alpha", "beta")),
        f"feed = @_decoupling_{f}({gains}.decoupling, measured.omega_m, turned);",
        *(put(f"feed_{x}", f"feed.{x}") for x in "dq"),
    ]
    for key in control.loops:
        name, limits = _LOOP_NAMES[key], f"{rows.arg('error')}, {rows.arg('limit')}"
        one, other = f"&@@_{name}_GAINS_{f.upper()}", f"&@@_{name}_VELOCITY_GAINS_{f.upper()}"
        body += [
            f"pi.integral = {rows.arg(f'{key}_integral')};",
            put(f"{key}_limited", f"@_pi_step_{f}({one}, &pi, {limits})"),
            put(f"{key}_integral", "pi.integral"),
            f"velocity.output = {rows.arg(f'{key}_output')};",
            f"velocity.proportional = {rows.arg(f'{key}_proportional')};",
            put(f"{key}_velocity", f"@_pi_velocity_step_{f}({other}, &velocity, {limits})"),
            put(f"{key}_output", "velocity.output"),
            put(f"{key}_proportional", "velocity.proportional"),
        ]
    if control.observer:
        own = f"&@@_REDUCED_ORDER_GAINS_{f.upper()}"
        body += [
            f"observer.zeta = {rows.arg('zeta')};",
            f"observer.omega_m = {taken('omega_hat')};",
            *(f"observer.i.{x} = {taken(f'last_{x}')};" for x in "dq"),
            f"@_reduced_order_step_{f}({own}, &observer, turned, reference);",
            put("next_zeta", "observer.zeta"),
            put("next_omega_hat", "observer.omega_m"),
        ]
    speed = f"{gains}, &control, measured.omega_m, {taken('speed_ref')}"
    begun = [
        *(
            [f"control.speed.integral = {rows.arg('speed_integral')};"]
            if "speed_integral" in rows.inputs
            else []
        ),
        f"control.filtered = {rows.arg('filtered')};",
        f"control.torque = {taken('torque')};",
        f"control.count = (uint32_t){rows.arg('count')};",
    ]
    body += [
        f"@_control_start_{f}(&control);",
        *begun,
        put("speed_loop_torque", f"@_speed_loop_{f}({speed})"),
        put("speed_loop_filtered", "control.filtered"),
        put("speed_loop_omega", "control.omega_m"),
        put("speed_loop_integral", "control.speed.integral"),
        put("speed_loop_count", f"({rows.wide})control.count"),
    ]
    step = f"{gains}, &control, &measured"
    calls = {"step": f"current_control_{f}({step}, reference)"}
    if control.reference is not None:
        calls["torque"] = f"torque_control_{f}({step}, {taken('torque')})"
        calls["whole"] = f"speed_control_{f}({step}, {taken('speed_ref')})"
    for kind, call in calls.items():
        body += [
            *(f"control.{x}.integral = {rows.arg(f'i_{x}_integral')};" for x in "dq"),
            *(begun if kind == "whole" else []),
            f"duty = @_{call};",
            *(
                put(f"torque_ref_{x}", f"control.reference.{x}")
                for x in ("dq" if kind == "torque" else "")
            ),
            *(put(f"{kind}_duty_{x}", f"({rows.wide})duty.{x}") for x in "abc"),
            *(put(f"{kind}_integral_{x}", f"control.{x}.integral") for x in "dq"),
            *(put(f"{kind}_{x}", f"control.v.{x}") for x in ("alpha", "beta")),
            *(put(f"{kind}_{x}", f"control.i.{x}") for x in "dq"),
            *(put(f"{kind}_v_{x}", f"control.v_dq.{x}") for x in "dq"),
        ]
    return rows.made(body)


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
            "largest_pole": abs(loop.found.poles[0]) if loop.exact.observed is None else None,
            "dead_band_codes": None if band is None else band.largest,
            "dead_band": fit.physical_band(name),
            "dead_band_in_one_word_codes": None
            if band is None
            else fit.word_dead_bands[name].largest,
        }
    ranges = [
        {"name": reach.name, "low": reach.range.low, "high": reach.range.high, "bits": reach.bits}
        for reach in fit.reaches
    ]
    fullest = {"name": fit.fullest.name, "share": fit.fullest.share}
    names = ("current_A", "voltage_V", "speed_rad_per_s", "torque_Nm")
    return {
        "loops": loops,
        "ranges": ranges,
        "fullest": fullest,
        "sine_error_codes": fit.sine_error,
        "one_code": dict(zip(names, fit.control.one_code, strict=True)),
        "dc_least_V": fit.control.dc_least_voltage,
        "speed_filter_dead_band_rad_per_s": fit.filter_band,
        "observer_dead_band_rad_per_s": fit.observer_band,
    }


def control_fixed_programme(control: FixedControl) -> Programme:
    """In 16 bits as many rows as there are angles, so that each comes once."""
    inputs = row_inputs(control, sweep_rows(control.width), SWEEP_SEED)
    results = row_results(control, inputs)
    return wide_programme(control_fixed_harness(control), inputs, results, "fixed-point control")


def sweep_rows(width: int) -> int:
    """How many rows a harness is given: in 16 bits as many as there are angles."""
    return 2**16 if width == 16 else SWEEP_POINTS


def wide_programme(harness: Harness, inputs: CodeArray, results: CodeArray, name: str) -> Programme:
    """The harness of a control in integers on rows of inputs and results, shapes (N, columns)."""
    wide = np.dtype(harness.number.removesuffix("_t"))
    return Programme(harness, inputs.astype(wide), results.astype(wide), name)


@dataclass(frozen=True, slots=True)
class IntegerRows:
    """Rows of a control in integers whose columns have names; words of twice the width."""

    width: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def number(self) -> str:
        """Type of a code."""
        return f"int{self.width}_t"

    @property
    def wide(self) -> str:
        """Type of a column."""
        return f"int{2 * self.width}_t"

    def arg(self, name: str) -> str:
        """A column."""
        return f"in[{self.inputs.index(name)}]"

    def taken(self, name: str) -> str:
        """A column as a code."""
        return f"({self.number}){self.arg(name)}"

    def put(self, name: str, value: str) -> str:
        """A statement that writes a result."""
        return f"out[{self.outputs.index(name)}] = {value};"

    def made(self, body: Sequence[str]) -> Harness:
        """The rows with their body."""
        told = f"{', '.join(self.inputs)}; {', '.join(self.outputs)}"
        counts = (len(self.inputs), len(self.outputs))
        return Harness(f"control_q{self.width - 1}", told, counts, tuple(body), self.wide)


# Control functions in fixed point on the terminal and in the report: integers, margins,
# dead bands, ranges.

_COLUMNS = (
    "loop",
    "kp",
    "error of kp",
    "ki t_s",
    "error of ki t_s",
    "error of q0 + q1",
    "largest pole",
    "phase margin deg",
    "with real gains",
    "dead band",
    "in one word",
)


def _rows(fit: FixedControlFit) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, loop in fit.loops.items():
        band = fit.dead_bands.get(name)
        rows.append(
            (
                name,
                loop.kp.text(),
                f"{loop.kp.error:+.1e}",
                loop.ki_ts.text(),
                f"{loop.ki_ts.error:+.1e}",
                f"{loop.velocity_ki_error:+.1e}",
                f"{abs(loop.found.poles[0]):.6f}" if loop.exact.observed is None else "-",
                f"{math.degrees(loop.found.phase_margin):.2f}"
                if loop.exact.observed is None
                else "-",
                margin_words(loop.exact)
                if loop.exact.observed
                else f"{math.degrees(loop.exact.phase_margin):.2f}",
                "none" if band is None else f"{band.largest}",
                "none" if band is None else f"{fit.word_dead_bands[name].largest}",
            )
        )
    return rows


def _title(fit: FixedControlFit) -> str:
    return f"Control in fixed point, {fit.control.format}: gains as integers"


def _bands(fit: FixedControlFit) -> str:
    """Dead bands in physical units, in one line."""
    parts = [
        f"{name} {fit.physical_band(name):.3g} {'rad/s' if name == 'speed' else 'A'}"
        for name in fit.dead_bands
    ]
    if "speed" in fit.loops:
        parts.append(f"speed filter {fit.filter_band:.3g} rad/s")
        parts.append(f"torque in steps of {fit.control.one_code[3]:.3g} N m")
    if fit.observer_band is not None:
        parts.append(f"speed observer {fit.observer_band:.3g} rad/s")
    return f"dead bands: {', '.join(parts) or 'none'};"


def _notes(fit: FixedControlFit) -> tuple[str, ...]:
    fullest, (current, _, speed, _) = fit.fullest, fit.control.one_code
    return (
        (
            f"{len(fit.reaches)} products and sums proven not to overflow; '{fullest.name}' "
            f"reaches {fullest.share:.3%}"
        ),
        (
            "dead band: smallest error in codes that moves the integral; in one word: an integral "
            "without fractional bits;"
        ),
        _bands(fit),
        (
            f"one code is {current:.3g} A, or {speed:.3g} rad/s; q0 + q1 is the integral gain of "
            "the velocity form"
        ),
    )


def control_fixed_tables(fits: Sequence[FixedControlFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    return [Table(_title(fit), _COLUMNS, tuple(_rows(fit)), _notes(fit)) for fit in fits]


def control_fixed_html(fits: Sequence[FixedControlFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    headings = tuple(symbols(text) for text in _COLUMNS)
    return [
        HtmlTable(_title(fit), headings, tuple(Row(row, "") for row in _rows(fit))) for fit in fits
    ]


def error_words(width: int, sine_error: float) -> str:
    """What a header says of the error of sine and cosine in codes."""
    found = "exhaustive" if width == 16 else "sampled"
    return f"; error at most {rounded_up(sine_error)} codes ({found})"
