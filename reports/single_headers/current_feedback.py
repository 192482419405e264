"""Current-feedback PWM: tables, JSON, figures, and what is emitted of a regulator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.names import SampledRuleName
from dqforge.machines.plants.regulator_rules import ACTIVE, RuleConstants
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_feedback.sampled_rules import (
    MOVES,
    TABLE,
    FeedbackEnds,
    FeedbackInputs,
    FeedbackPair,
    SampledRule,
    next_codes,
)
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    single_from,
    title,
)
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.capability import Capability, Draw, Passage, ReportPart, Rows
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import SERIES, new_figure, style
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import CURRENT_FEEDBACK as CHAPTER
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import comment, record_structs, vector_struct
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.steps.word_reader import WordReader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.current_feedback.regulator_runs import (
        CurrentFeedback,
        DesignPattern,
        LoadRuns,
        RegulatorPlan,
        RegulatorRun,
    )
    from dqforge.optimizer.losses.drive_budget import DriveBudget
    from dqforge.optimizer.solution import Solution


_RUN_COLUMNS = (
    "regulator", "rpm", "kHz", "from", "to", "error A", "peak A", "THD %", "N m", "total W", "",
)  # fmt: skip

_LOSS_COLUMNS = (
    "regulator", "kHz", "THD %", "N m", "copper W", "ripple W", "conduction W", "switching W",
    "total W", "",
)  # fmt: skip

_COLUMNS_SAID = (
    "kHz: switching frequency of a leg, its mean and from the longest to the shortest time between "
    "turn-ons; error and peak: of a phase current; THD: of the phase currents; N m: torque made."
)


def _text(value: float, digits: int = 3) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _loss_cells(budget: DriveBudget, index: int | tuple[int, int]) -> tuple[str, ...]:
    parts = (
        budget.torque, budget.copper, budget.ripple_copper, budget.conduction, budget.switching,
        budget.total,
    )  # fmt: skip
    return tuple(_text(float(part[index])) for part in parts)


def _mark(run: RegulatorRun, point: int, chosen: str) -> str:
    return run.obstacles[point] or ("chosen" if run.plan.method == chosen else "")


def run_cells(run: RegulatorRun, chosen: str = "") -> list[tuple[str, ...]]:
    """One row per point of a regulator; ``chosen`` is the design's method."""
    rows = []
    for p, omega_m in enumerate(run.points.omega_m):
        frequencies = (run.frequency, run.lowest, run.highest)
        rows.append(
            (
                run.plan.method,
                f"{in_rpm(omega_m):.0f}",
                *(_text(1e-3 * float(part[p]), 2) for part in frequencies),
                _text(float(run.rms_error[p])),
                _text(float(run.largest_error[p])),
                _text(100.0 * float(run.distortion[p]), 1),
                _text(float(run.budget.torque[p])),
                _text(float(run.budget.total[p]), 2),
                _mark(run, p, chosen),
            )
        )
    return rows


def settings_table(plan: RegulatorPlan) -> Table:
    """What a regulator has instead of gains."""
    return Table("Current-feedback PWM", ("", ""), tuple(setting_rows(plan)))


def own_table(found: CurrentFeedback) -> Table:
    """Settings of the regulator, what it does over speed, and the speed loop over it."""
    rows = (*setting_rows(found.plan), *run_rows(found.run), *speed_rows(found))
    notes = (ASSUMED, *((SPEED_LOOP,) if found.speed is not None else ()))
    return Table("Current-feedback PWM instead of current loops", ("", ""), rows, notes)


def compared_table(found: CurrentFeedback) -> Table:
    """All regulators over speed with half of the largest torque."""
    rows = [row for run in found.over_speed for row in run_cells(run, found.plan.method)]
    torque = float(found.run.points.torque[0])
    title = f"All regulators over speed, asked for {torque:.4g} N m"
    return Table(title, _RUN_COLUMNS, tuple(rows), (_COLUMNS_SAID, ASSUMED))


def point_table(run: RegulatorRun) -> Table:
    """One regulator at its points."""
    return Table(
        f"{run.plan.method} at constant speed", _RUN_COLUMNS, tuple(run_cells(run)), (ASSUMED,)
    )


def load_tables(loads: LoadRuns) -> list[Table]:
    """One table per load: every regulator, and the modulators at the chosen one's frequency."""
    tables, chosen = [], loads.runs[loads.own]
    for p, (torque, omega_m) in enumerate(
        zip(chosen.points.torque, chosen.points.omega_m, strict=True)
    ):
        rows = [
            (
                run.plan.method,
                _text(1e-3 * float(run.frequency[p]), 2),
                _text(100.0 * float(run.distortion[p]), 1),
                *_loss_cells(run.budget, p),
                _mark(run, p, chosen.plan.method),
            )
            for run in loads.runs
        ]
        for m, name in enumerate(loads.modulations):
            rows.append(
                (
                    name,
                    _text(1e-3 * float(chosen.frequency[p]), 2),
                    _text(100.0 * float(loads.distortion[m, p]), 1),
                    *_loss_cells(loads.budget, (m, p)),
                    "",
                )
            )
        title = f"Losses by current feedback at {torque:.4g} N m, {in_rpm(omega_m):.5g} rpm"
        tables.append(Table(title, _LOSS_COLUMNS, tuple(rows), (BESIDE, ASSUMED)))
    return tables


def html_tables(found: CurrentFeedback) -> list[HtmlTable]:
    """The same for the report."""
    loads = [] if found.loads is None else load_tables(found.loads)
    return [_as_html(table) for table in (own_table(found), compared_table(found), *loads)]


def _as_html(table: Table) -> HtmlTable:
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in table.rows)
    narrow = len(table.columns) == 2
    columns = ("", "value") if narrow else table.columns
    notes = tuple(symbols(note) for note in table.notes)
    heads = tuple(symbols(text) for text in columns)
    return HtmlTable(symbols(table.title), heads, rows, 2 if narrow else 1, notes)


# The C header of a sampled regulator with its model, and that of settings for comparators.

_FAULT = InputError("current_feedback_header is not what dqforge writes; run the design again")

_NUMBERS = ("r_s", "l_d", "l_q", "psi_pm", "t_s", "band", "outer_band")


def plain_rule(constants: RuleConstants) -> PlainData:
    """The rule as plain data, in double precision: the C rounds what is made of it."""
    return {"rule": constants.rule} | {name: getattr(constants, name) for name in _NUMBERS}


def rule_from(plain: Mapping[str, Any]) -> RuleConstants:
    """Read a rule back.

    Raises:
        InputError: The data are not what `plain_rule` makes.
    """
    try:
        numbers = {name: plain[name] for name in _NUMBERS}
        for value in numbers.values():
            single_from(value)
        if (
            plain["rule"] not in get_args(SampledRuleName)
            or min(numbers[name] for name in ("l_d", "l_q", "t_s")) <= 0.0
        ):
            raise _FAULT
        return RuleConstants(plain["rule"], **{name: float(numbers[name]) for name in numbers})
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error


def rule_inputs(constants: RuleConstants, count: int, seed: int) -> NDArray[np.float32]:
    """Rows (state, references, currents, cosine, sine, speed, link), shape (N, 9): errors far
    within and beyond the bands at all angles and speeds, some of them not finite.
    """
    generator = np.random.default_rng(seed)
    scale = max(constants.outer_band, 1e-3 * constants.psi_pm / constants.l_d, 1e-3)
    theta = generator.uniform(-math.pi, math.pi, count)
    place = generator.uniform(-math.pi, math.pi, count)
    size = scale * 10.0 ** generator.uniform(-2.0, 1.0, count)
    speed = generator.uniform(-0.2, 0.2, count) / constants.t_s
    rows = np.empty((count, 9))
    rows[:, 0] = generator.integers(0, 8, count)
    rows[:, 1:3] = generator.normal(0.0, 4.0 * scale, (count, 2))
    rows[:, 3] = rows[:, 1] + size * np.cos(place)
    rows[:, 4] = rows[:, 2] + size * np.sin(place)
    rows[:, 5], rows[:, 6] = np.cos(theta), np.sin(theta)
    rows[:, 7] = speed
    # A link that moves the error by some tenths to some multiples of the scale in a sample.
    steps = 10.0 ** generator.uniform(-1.0, 0.7, count)
    rows[:, 8] = steps * scale * constants.l_d / constants.t_s
    rows[::97, 3] = math.nan
    rows[50::97, 8] = math.inf
    rows[20::97, 1:8] = 0.0
    return rows.astype(np.float32)


def rule_outputs(constants: RuleConstants, rows: NDArray[np.float32]) -> NDArray[np.uint32]:
    """What the compiled rule must return for rows of `rule_inputs`, shape (N, 1)."""
    codes = next_codes(constants, rows[:, 0].astype(np.int64), *rows[:, 1:].T)
    return codes.astype(np.uint32)[:, None]


def rule_programme(constants: RuleConstants) -> Programme:
    """The harness of a sampled regulator, with what its model answers."""
    rows = rule_inputs(constants, SWEEP_POINTS, SWEEP_SEED)
    outputs = rule_outputs(constants, rows)
    name = f"{constants.rule} regulator"
    members = ", ".join(f"in[{k}]" for k in range(1, 9))
    told = Harness(
        "current_feedback",
        "state and inputs; the next state",
        (9, 1),
        (
            f"const @_feedback_inputs_t inputs = {{ {members} }};",
            "",
            "out[0] = @_next_state((uint32_t)in[0], &inputs);",
        ),
        result="uint32_t",
        vectors=False,
    )
    return Programme(told, rows, outputs, name)


def _speed_lines(design: Design, found: CurrentFeedback) -> list[str]:
    """Constants of the speed loop over the regulator."""
    if found.speed is None:
        return []
    macro = design.export.prefix.upper()
    speed, per_sample = found.speed, "/* per sample, N m s/rad */"
    return [
        "",
        "/* Speed loop over this regulator: torque = kp e + integral, parallel form. */",
        f"#define {macro}_FEEDBACK_SPEED_KP ({float_literal(speed.kp)}) /* N m s/rad */",
        f"#define {macro}_FEEDBACK_SPEED_KI_TS ({float_literal(speed.ki_ts)}) {per_sample}",
        f"#define {macro}_FEEDBACK_SPEED_T_S ({float_literal(speed.t_s)}) /* sampling period, s */",
    ]


def _header(
    design: Design, found: CurrentFeedback, includes: list[str], body: list[str]
) -> dict[str, bytes]:
    """Name and bytes of the header with a body."""
    context: PlainData = {
        **title(design),
        "part": "current_feedback",
        "subject": f"{found.plan.method} regulator of the phase currents",
        "preamble": emitted_lines(design, found),
        "includes": includes,
        "vectors": False,
        "body": "\n".join([*body, *_speed_lines(design, found)]),
    }
    text = render("c_code/header.h.j2", context)
    return {f"{design.export.prefix}_current_feedback.h": text.encode("ascii")}


def rule_files(design: Design, found: CurrentFeedback) -> dict[str, bytes]:
    """Name and bytes of the header of a sampled regulator; none of others."""
    constants, prefix = found.rule, design.export.prefix
    if constants is None:
        return {}
    includes = ["<stdint.h>"] if constants.rule == "predictive" else ["<math.h>", "<stdint.h>"]
    return _header(design, found, includes, rule_text(constants, prefix))


def rule_text(constants: RuleConstants, prefix: str) -> list[str]:
    """Macros, types, tables and functions of a rule.

    Args:
        constants: The rule.
        prefix: Before all names.
    """
    macro, zero = f"{prefix.upper()}_FEEDBACK", cast("Any", 0.0)
    inputs = FeedbackInputs(*(zero,) * 8)
    pair = FeedbackPair(zero, zero)
    reader = WordReader(prefix, Functions(), Block("", set()))
    rule = SampledRule(constants)
    reader.write("next_state", rule.next_state, [Expression("state", kind="uint32_t"), inputs])
    tables = [
        _words(
            f"{macro}_MOVES",
            MOVES,
            "Legs that commutate, by the bits that change: bit 0 leg a, bit 1 leg b, bit 2 leg c.",
        )
    ]
    numbers = [("T_S", constants.t_s, "sampling period, s")]
    if constants.rule == "circle":
        numbers.append(("RADIUS_A", constants.band, "largest error of the current vector, A"))
    if constants.rule == "look-up-table":
        numbers += [
            ("BAND_A", constants.band, "error of a phase that keeps the state, A"),
            ("OUTER_BAND_A", constants.outer_band, "error of a phase that is a transient, A"),
        ]
        tables += [
            _words(f"{macro}_ACTIVE", ACTIVE, "States along the error, by its region."),
            [
                "/* States by sector of the voltage and region of the error. */",
                f"static const uint32_t {macro}_TABLE[6][6] = {{",
                *(f"    {{ {', '.join(f'{code}U' for code in row)} }}," for row in TABLE),
                "};",
            ],
        ]
    defines = [
        f"#define {macro}_{name} ({float_literal(value)}) /* {meaning} */"
        for name, value, meaning in numbers
    ]
    ends = [] if constants.rule == "look-up-table" else [FeedbackEnds((pair,) * len(MOVES))]
    blocks = [
        defines,
        *record_structs(inputs, prefix),
        vector_struct(FeedbackPair, prefix),
        *(lines for end in ends for lines in record_structs(end, prefix)),
        *tables,
        *([text] for text in reader.functions.texts.values()),
    ]
    return "\n\n".join("\n".join(lines) for lines in blocks).split("\n")


def _words(name: str, values: Sequence[int], meaning: str) -> list[str]:
    """A table of words."""
    told = ", ".join(f"{value}U" for value in values)
    return [f"/* {meaning} */", f"static const uint32_t {name}[{len(values)}] = {{ {told} }};"]


def settings_files(design: Design, found: CurrentFeedback) -> dict[str, bytes]:
    """Name and bytes of the settings of comparators or patterns; none of sampled rules."""
    plan, sensing = found.plan, design.inverter.current_sensing
    if found.rule is not None:
        return {}
    numbers: list[tuple[str, float, str]] = []
    if plan.method == "hysteresis":
        numbers.append(("FEEDBACK_BAND_A", plan.band, "comparators at reference -+ this, A"))
        if sensing is not None:
            counts = round(plan.band / sensing.step)
            meaning = f"the same in codes of {sensing.bits} bits, {sensing.step:.4g} A each"
            numbers.append(("FEEDBACK_BAND_COUNTS", counts, meaning))
    elif plan.method == "ramp-comparison":
        numbers += [
            ("FEEDBACK_KP", plan.kp, "both axes, V/A"),
            ("FEEDBACK_KI", plan.ki, "both axes, in rotor coordinates, V/(A s)"),
            ("FEEDBACK_CARRIER_HZ", plan.carrier, "triangle, Hz"),
            ("FEEDBACK_TRIANGLE_V", 0.5 * design.inverter.v_dc, "its amplitude: half of v_dc, V"),
            ("FEEDBACK_COMPARATOR_BAND_V", plan.comparator_band, "comparators, edge to edge, V"),
        ]
    else:
        numbers.append(("FEEDBACK_T_S", plan.t_s, "sampling period of the error, s"))
    macro = design.export.prefix.upper()
    body = [
        f"#define {macro}_{name} ({value if isinstance(value, int) else float_literal(value)}) "
        f"/* {comment_text(meaning)} */"
        for name, value, meaning in numbers
    ]
    return _header(design, found, [], [*body, *_pattern_lines(design, found.patterns)])


_PATTERN = (
    "Patterns: amplitude over v_dc/2, level of a leg behind the angle 0 of its voltage's sine, "
    "angles of a quarter in rad."
)


def _pattern_lines(design: Design, patterns: Sequence[DesignPattern]) -> list[str]:
    """Type and table of pulse patterns; nothing without one."""
    if not patterns:
        return []
    prefix, most = design.export.prefix, max(len(pattern.angles) for pattern in patterns)
    rows = []
    for pattern in patterns:
        angles = [*pattern.angles, *[0.0] * (most - len(pattern.angles))]
        index, level = float_literal(pattern.index), float_literal(pattern.sign)
        told = ", ".join(map(float_literal, angles))
        rows.append(f"    {{ {index}, {level}, {{ {told} }}, {len(pattern.angles)}U }},")
    name = f"{prefix}_pulse_pattern_t"
    return [
        "",
        *comment(_PATTERN),
        "typedef struct {",
        "    float index;",
        "    float first_level;",
        f"    float angles[{most}];",
        "    unsigned int count;",
        f"}} {name};",
        "",
        f"static const {name} {prefix}_pulse_patterns[{len(patterns)}] = {{",
        *rows,
        "};",
    ]


# Current-feedback PWM in words.

ASSUMED = (
    "At constant speed with an ideal bridge: no dead time, no delay of comparators. Sampled "
    "regulators have their computing time of one sample and the numbers of the emitted C."
)

BESIDE = (
    "Modulators are at the mean switching frequency of the chosen regulator, with the currents "
    "that make the torque; a regulator whose mean current is off makes another torque with other "
    "losses."
)

SPEED_LOOP = (
    "The speed loop takes the regulator as a first-order lag; what it makes of errors of the mean "
    "current is left to its integral."
)

NOT_EMITTED = {
    "hysteresis": (
        "Analog comparators: each leg goes down where its current exceeds the reference by the "
        "band, up where it falls short of it by the band; the references are the user's DAC."
    ),
    "ramp-comparison": (
        "Analog regulators and comparators: v = kp e + ki integral(e) in rotor coordinates, back "
        "to phases; a leg is up while v exceeds the triangle."
    ),
    "trajectory": (
        "The edges of the pattern are the user's timers; each sample moves the next edge of a leg "
        "by the flux error over v_dc, later for an edge up with too much current."
    ),
}


def _number(value: float, unit: str) -> str:
    return format_quantity(value, unit, 4)


def setting_rows(plan: RegulatorPlan) -> list[tuple[str, str]]:
    """What a regulator has instead of gains and margins."""
    band = ("band", f"{_number(plan.band, 'A')} to either side")
    sampling = ("sampling", f"{_number(1.0 / plan.t_s, 'Hz')}, {_number(plan.t_s, 's')}")
    rows = {
        "hysteresis": [band],
        "ramp-comparison": [
            ("kp, ki", f"{plan.kp:.4g} V/A, {plan.ki:.4g} V/(A s)"),
            ("carrier", _number(plan.carrier, "Hz")),
            ("comparator band", f"{plan.comparator_band:.4g} V"),
        ],
        "look-up-table": [
            band,
            ("outer band", f"{_number(plan.outer_band, 'A')}: a transient beyond it"),
            sampling,
        ],
        "circle": [("radius", _number(plan.band, "A")), sampling],
        "predictive": [sampling],
        "trajectory": [("most pulses", f"{plan.pulses} per electrical period"), sampling],
    }
    return [("regulator", plan.method), *rows[plan.method]]


def _range(low: float, high: float, unit: str) -> str:
    first, last = _number(low, unit), _number(high, unit)
    return first if first == last else f"{first} to {last}"


def run_rows(run: RegulatorRun) -> list[tuple[str, str]]:
    """Ranges of what a regulator does over speed."""
    known = [k for k, text in enumerate(run.obstacles) if not text]
    if not known:
        return [("not possible", run.obstacles[0])]

    def ends(values: FloatArray, unit: str) -> str:
        numbers = [float(values[k]) for k in known]
        return _range(min(numbers), max(numbers), unit)

    rows = [
        ("switching frequency", f"{ends(run.frequency, 'Hz')} on average over speed"),
        ("error", f"{ends(run.rms_error, 'A')} r.m.s., {ends(run.largest_error, 'A')} at most"),
    ]
    distortion = [100.0 * float(run.distortion[k]) for k in known]
    return [*rows, ("distortion", f"{min(distortion):.3g} to {max(distortion):.3g} %")]


def speed_rows(found: CurrentFeedback) -> list[tuple[str, str]]:
    """The speed loop over the regulator."""
    if found.speed is None or found.equivalent is None:
        return []
    speed, lag = found.speed, found.equivalent
    margin = math.degrees(speed.margins.phase_margin)
    return [
        (
            "current loop as the speed loop sees it",
            f"lag of {_number(lag.bandwidth, 'rad/s')} (delay {_number(lag.delay, 's')})",
        ),
        ("speed kp, ki", f"{speed.kp:.4g} N m s/rad, {speed.ki:.4g} N m/rad"),
        (
            "speed loop",
            f"crossover {_number(speed.margins.crossover, 'rad/s')}, phase margin {margin:.3g} deg",
        ),
    ]


def emitted_lines(design: Design, found: CurrentFeedback) -> list[str]:
    """What the header says of itself."""
    plan = found.plan
    lines = [f"{label}: {text}." for label, text in (*setting_rows(plan)[1:], *run_rows(found.run))]
    if plan.method in NOT_EMITTED:
        lines = [*lines, "", NOT_EMITTED[plan.method]]
        if plan.method == "hysteresis" and design.inverter.current_sensing is None:
            lines.append("Codes of a DAC need inverter.current_sensing in the design.")
        return lines
    return [
        *lines,
        "",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
        "The function knows the state that is on now and names that of the next period; it",
        "predicts the currents at the next sample, so that the computing time is part of it.",
        "Not-a-number keeps the present state.",
    ]


# Current-feedback PWM as plain data.


def plain_plan(plan: RegulatorPlan) -> PlainData:
    """Numbers of a regulator, those that its method does not use too."""
    return {
        "method": plan.method,
        "band_A": plan.band,
        "outer_band_A": plan.outer_band,
        "kp": plan.kp,
        "ki": plan.ki,
        "carrier_Hz": plan.carrier,
        "comparator_band_V": plan.comparator_band,
        "t_s": plan.t_s,
        "pulses": plan.pulses,
    }


def plain_run(run: RegulatorRun) -> list[PlainData]:
    """One entry per point."""
    numbers = {
        "torque_asked_Nm": run.points.torque,
        "omega_m_rad_per_s": run.points.omega_m,
        "i_d_A": run.points.i_d,
        "i_q_A": run.points.i_q,
        "frequency_Hz": run.frequency,
        "lowest_Hz": run.lowest,
        "highest_Hz": run.highest,
        "rms_error_A": run.rms_error,
        "largest_error_A": run.largest_error,
        "distortion": run.distortion,
        "stored_W": run.stored,
        "torque_Nm": run.budget.torque,
        "shaft_W": run.budget.shaft_power,
        "input_W": run.budget.input_power,
        "total_W": run.budget.total,
        "junction_degC": run.budget.junction_temperature,
    } | {f"{part}_W": getattr(run.budget, part) for part in PARTS}
    return [
        {"method": run.plan.method, "obstacle": run.obstacles[p] or None}
        | {name: _or_none(values[p]) for name, values in numbers.items()}
        for p in range(run.points.omega_m.size)
    ]


def _or_none(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)


def plain_loads(loads: LoadRuns | None) -> PlainData | None:
    """Regulators and modulators at the loads."""
    if loads is None:
        return None
    own, budget = loads.runs[loads.own], loads.budget
    return {
        "regulators": [entry for run in loads.runs for entry in plain_run(run)],
        "modulators": [
            {
                "modulation": name,
                "torque_asked_Nm": own.points.torque[p],
                "omega_m_rad_per_s": own.points.omega_m[p],
                "frequency_Hz": _or_none(own.frequency[p]),
                "ripple_current_A": _or_none(budget.ripple_current[m, p]),
                "distortion": _or_none(loads.distortion[m, p]),
                "torque_Nm": _or_none(budget.torque[m, p]),
                "total_W": _or_none(budget.total[m, p]),
            }
            | {f"{part}_W": _or_none(getattr(budget, part)[m, p]) for part in PARTS}
            for m, name in enumerate(loads.modulations)
            for p in range(own.points.omega_m.size)
        ],
    }


def plain_feedback(found: CurrentFeedback) -> PlainData:
    """What ``result.json`` says of it."""
    speed, lag = found.speed, found.equivalent
    return {
        "regulator": plain_plan(found.plan),
        "over_speed": [entry for run in found.over_speed for entry in plain_run(run)],
        "loads": plain_loads(found.loads),
        "speed": None
        if speed is None or lag is None
        else {
            "lag_rad_per_s": lag.bandwidth,
            "delay_s": lag.delay,
            "kp": speed.kp,
            "ki": speed.ki,
            "ki_ts": speed.ki_ts,
            "crossover_rad_per_s": speed.margins.crossover,
            "phase_margin_rad": speed.margins.phase_margin,
        },
        "patterns": [
            {
                "omega_m_rad_per_s": pattern.omega_m,
                "index": pattern.index,
                "first_level": pattern.sign,
                "angles_rad": list(pattern.angles),
            }
            for pattern in found.patterns
        ],
    }


# Current-feedback PWM, as a record.


def _summary(_: Solution, found: CurrentFeedback) -> Rows:
    return [*setting_rows(found.plan), *run_rows(found.run)]


def _tables(_: Solution, found: CurrentFeedback) -> list[Table]:
    loads = [] if found.loads is None else load_tables(found.loads)
    return [own_table(found), compared_table(found), *loads]


def _parts(_: Solution, found: CurrentFeedback) -> list[ReportPart]:
    caption = (
        "Six regulators over speed: mean switching frequency of a leg, r.m.s. error of a phase, "
        "distortion of the phase currents, total loss."
    )
    drawings, tables = [("current_feedback", caption)], html_tables(found)
    return [Passage(drawings=drawings, tables=tables, kind="modulation").of(CHAPTER)]


def _figures(_: Solution, found: CurrentFeedback) -> Mapping[str, Draw]:

    return {"current_feedback": lambda: plot_regulators(found.over_speed)}


def _plain_rule(_: Solution, found: CurrentFeedback) -> PlainData | None:
    return None if found.rule is None else plain_rule(found.rule)


CURRENT_FEEDBACK = Capability(
    name="current_feedback",
    title="current-feedback PWM",
    of=lambda outcome: outcome.solution.current_feedback,
    plain=lambda _, found: plain_feedback(found),
    always=False,
    summary=_summary,
    tables=_tables,
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="current_feedback",
            files=lambda solution, found: rule_files(solution.design, found),
            plain=_plain_rule,
            read=lambda own, _: rule_from(own),
            programme=rule_programme,
            vectors=False,
        ),
    ),
    emitted=lambda solution, found: settings_files(solution.design, found),
)


# Figure of the six regulators over speed.


def plot_regulators(runs: Sequence[RegulatorRun]) -> Figure:
    """Switching frequency, r.m.s. error, distortion and total loss over speed."""
    labels = (
        "Mean switching frequency in kHz",
        "Error of a phase in A r.m.s.",
        "Distortion in %",
        "Total loss in W",
    )
    with style():
        figure = new_figure(
            "current-feedback",
            4.6,
            "Frequency, error, distortion and loss of six regulators",
        )
        panels = figure.subplots(2, 2, sharex=True).ravel()
        figure.subplots_adjust(
            left=0.075, right=0.985, top=0.92, bottom=0.095, hspace=0.12, wspace=0.2
        )
        for run, colour in zip(runs, SERIES, strict=False):
            rpm = in_rpm(run.points.omega_m)
            shown = (
                run.frequency / 1e3,
                run.rms_error,
                100.0 * run.distortion,
                run.budget.total,
            )
            for axes, values in zip(panels, shown, strict=True):
                axes.plot(rpm, values, "o-", color=colour, label=run.plan.method, markersize=3)
        for axes, label in zip(panels, labels, strict=True):
            axes.set(ylabel=label, ylim=(0.0, None))
        for axes in panels[2:]:
            axes.set_xlabel("Speed in rpm")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="upper center", ncols=6, frameon=False, fontsize=7.5)
    return figure
