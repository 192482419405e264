"""The C header of a position observer in fixed point, as plain data and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.transforms import Pair, in_rpm
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FIXED_METHODS,
    FixedObserverFit,
    FixedPositionObserver,
    observer_reaches,
)
from dqforge.optimizer.fixed_observers.kit import TOP, WIDTH, TrackedState, shown, widened
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    integer_kinds,
    title,
)
from dqforge.reports.capability import Capability
from dqforge.reports.control.fixed_header import error_words
from dqforge.reports.control.fixed_model import gain_from, one_of, positive, whole
from dqforge.reports.pages.templating import render
from dqforge.reports.steps.code_text import code_basics, code_types
from dqforge.reports.steps.integer_text import integer_observer_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


# Rows of integers through an observer in fixed point: states and inputs that reach the ends, and
# what must come out.

_LENGTH = 50


def input_names(observer: FixedPositionObserver) -> tuple[str, ...]:
    """Columns of the inputs: whether it has started, the state before, voltage and current."""
    words = tuple(word.name for word in observer.method.words)
    return ("started", "theta", "omega", *words, "v_alpha", "v_beta", "i_alpha", "i_beta")


def output_names(observer: FixedPositionObserver) -> tuple[str, ...]:
    """Columns of the results: the state after, and what is shown of it."""
    words = tuple(word.name for word in observer.method.words)
    return ("theta", "omega", *words, "theta_e", "omega_m")


def _limits(observer: FixedPositionObserver) -> list[tuple[int, int]]:
    code = 2 ** (observer.width - 1)
    words = [(limit.low, limit.high) for limit in observer.method.limits(observer.gains)]
    state = [(0, 1), (0, 2**WIDTH - 1), (-TOP - 1, TOP), *words]
    return [*state, *((-code, code - 1),) * 4]


def row_inputs(observer: FixedPositionObserver, count: int, seed: int) -> CodeArray:
    """Inputs of shape (count, columns).

    A half of the rows are the samples of drives that turn, at any speed and with rough noise; the
    others are spread over all that the words hold, some of them at the ends and near zero. One in
    sixteen is a first sample.
    """
    generator = np.random.default_rng(seed)
    columns = []
    for low, high in _limits(observer):
        even = generator.integers(low, high, count, endpoint=True)
        special = generator.choice(np.array([low, low + 1, -1, 0, 1, high - 1, high]), count)
        some = generator.random(count) < 1.0 / 4.0
        columns.append(np.where(some, np.clip(special, low, high), even))
    rows = np.stack(columns, axis=1)
    rows[:, 0] = generator.random(count) >= 1.0 / 16.0
    turning = _turning(observer, count // 2, generator)
    rows[: len(turning)] = turning
    return rows


def _turning(
    observer: FixedPositionObserver, count: int, generator: np.random.Generator
) -> CodeArray:
    """Rows along sequences of samples, each with the state that the one before has left."""
    top = 2 ** (observer.width - 1) - 1
    drives = count // _LENGTH
    if drives == 0:
        return np.empty((0, len(input_names(observer))), dtype=np.int64)
    o, method = Integers(), observer.method
    speed = generator.uniform(-1.0, 1.0, drives)
    turn = speed * observer.turn
    theta = generator.uniform(-np.pi, np.pi, drives)
    sizes = 10.0 ** generator.uniform(-3.0, 0.0, (2, drives))
    shift = np.array([1.6, 0.03, 1.5, -0.1])[:, None]
    angle = np.asarray(theta / np.pi * 2.0**31, dtype=np.int64) % 2**WIDTH
    right = generator.choice([0.0, 0.5, 1.0, -1.0], drives)
    omega = np.asarray(speed * right * TOP, dtype=np.int64)
    words = (np.zeros(drives, np.int64),) * len(method.words)
    state: TrackedState[Any] = TrackedState(angle, omega, words)
    rows = []
    for k in range(_LENGTH):
        noise = 0.02 * generator.standard_normal((4, drives))
        wave = np.cos(theta + k * turn + shift) + noise
        seen = np.rint(np.repeat(sizes, 2, axis=0) * wave * top)
        codes = np.clip(seen, -top - 1, top).astype(np.int64)
        started = np.full(drives, min(k, 1))
        rows.append(_columns(started, state.theta, state.omega, *state.words, *codes))
        state = _after(o, observer, rows[-1])
    return np.concatenate(rows)


def _columns(*parts: CodeArray) -> CodeArray:
    """Columns side by side, constants repeated."""
    return np.stack(np.broadcast_arrays(*parts), axis=1)


def _after(o: Integers, observer: FixedPositionObserver, rows: CodeArray) -> TrackedState[Any]:
    """States after the samples of rows, all of which have started, or none."""
    width, method = observer.width, observer.method
    bits = WIDTH - width
    columns = [rows[:, k] for k in range(rows.shape[1])]
    started, theta, omega, *words = columns[:-4]
    v_alpha, v_beta, i_alpha, i_beta = (
        widened(o, "voltage or current", part, width) for part in columns[-4:]
    )
    v, i = Pair(v_alpha, v_beta), Pair(i_alpha, i_beta)
    if np.all(started != 0):
        return method.step(o, observer.gains, TrackedState(theta, omega, tuple(words)), v, i)
    empty = np.zeros_like(theta)
    begun = TrackedState(
        widened(o, "angle or speed of the start", theta >> bits, width),
        widened(o, "angle or speed of the start", omega >> bits, width),
        (empty,) * len(words),
    )
    return method.begin(o, observer.gains, begun, v, i)


def row_results(
    observer: FixedPositionObserver, inputs: CodeArray, arithmetic: Integers | None = None
) -> CodeArray:
    """Results for rows of inputs, shape (rows, results), columns as `output_names`."""
    o = Integers() if arithmetic is None else arithmetic
    results = np.empty((len(inputs), len(output_names(observer))), dtype=np.int64)
    for started in (False, True):
        chosen = (inputs[:, 0] != 0) == started
        if np.any(chosen):
            state = _after(o, observer, inputs[chosen])
            seen = shown(o, state, observer.width)
            results[chosen] = _columns(state.theta, state.omega, *state.words, *seen)
    return results


# A position observer in fixed point read back from ``result.json``, and proven again not to
# overflow.

NOT_OURS = InputError(
    "observer_q15_header or observer_q31_header is not what dqforge writes; run the design again"
)

_SHIFTS = ("shift", "bits")


def fixed_observer_from(plain: Mapping[str, Any], width: int) -> FixedPositionObserver:
    """Read an observer back behind a control of ``width`` bits, and prove again that nothing
    overflows.

    Raises:
        InputError: The data are not what `plain_fixed_observer` makes.
    """
    try:
        method = FIXED_METHODS[plain["method"]]
        current, voltage, speed = positive(plain["bases"], 3)
        (turn,) = positive((plain["turn"],), 1)
        found = FixedPositionObserver(
            method,
            _record_from(method.gains, plain["gains"]),
            one_of(plain["width"], (width,)),
            (current, voltage, speed),
            turn,
        )
        observer_reaches(method, found.gains, width)
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, NoSolutionError):
        raise NOT_OURS from None
    return found


def _record_from(kind: type[Any], plain: Mapping[str, Any]) -> Any:
    if kind is FixedGain:
        return gain_from(plain, WIDTH)
    hints = get_type_hints(kind)
    return kind(**{f.name: _value_from(f.name, hints[f.name], plain[f.name]) for f in fields(kind)})


def _value_from(name: str, hint: Any, value: Any) -> Any:
    if hint is int:
        return whole(value, 0, 2 * WIDTH - 2) if name in _SHIFTS else whole(value, -(2**63), 2**63)
    if is_dataclass(hint):
        return _record_from(hint, value)  # type: ignore[arg-type]
    inner = get_args(hint)[0]
    if not isinstance(value, list | tuple):
        raise TypeError(name)
    return tuple(_value_from(name, inner, item) for item in value)


# The C header of a position observer in fixed point, as plain data and as text.

_SEED = 20_261_122


def plain_fixed_observer(observer: FixedPositionObserver) -> PlainData:
    """Method, format, full scales and integers as plain data."""
    return {
        "method": observer.method.name,
        "width": observer.width,
        "bases": list(observer.bases),
        "turn": observer.turn,
        "gains": asdict(observer.gains),
    }


def plain_observer_evidence(fit: FixedObserverFit) -> PlainData:
    """The proven range of every product and sum, and what one code is, as plain data."""
    ranges = [
        {"name": reach.name, "low": reach.range.low, "high": reach.range.high, "bits": reach.bits}
        for reach in fit.reaches
    ]
    return {
        "ranges": ranges,
        "fullest": {"name": fit.fullest.name, "share": fit.fullest.share},
        "sine_error_codes": fit.sine_error,
        "angle_step_rad": fit.angle_step,
        "speed_step_rad_per_s": fit.speed_step,
    }


def _preamble(fit: FixedObserverFit, design: Design) -> list[str]:
    observer, fullest = fit.observer, fit.fullest
    bits, code, prefix = observer.width, observer.method.code, design.export.prefix
    current, voltage, speed = observer.bases
    return [
        f"Method: {METHODS[observer.method.name].title}, every {design.control.t_s * 1e6:.6g} us.",
        *wrap(
            f"Full scales, 2^{bits - 1} codes of int{bits}_t: {current:.6g} A, {voltage:.6g} V "
            f"(peak of phase), {speed:.6g} rad/s (mechanical); 2^{bits} codes of uint{bits}_t are "
            "a turn (electrical).",
            110,
        ),
        *wrap(
            "Inside all codes have 32 bits, products 64: filters and loop would come to rest in "
            f"dead bands of 16. What is shown is rounded to {math.degrees(fit.angle_step):.3g} deg "
            f"and {in_rpm(fit.speed_step):.3g} rpm; an estimated speed beyond full scale "
            "saturates.",
            110,
        ),
        *wrap(
            f"No overflow for any inputs and any past: {len(fit.reaches)} products and sums proven "
            f"by interval analysis; the fullest, '{fullest.name}', reaches {fullest.share:.4%} of "
            f"int{fullest.bits}_t.",
            110,
        ),
        "",
        *wrap(
            f"Call {prefix}_{code}_start_{observer.format}() once and "
            f"{prefix}_{code}_step_{observer.format}() at every sample with the voltage that acted "
            "over the period that ends there; both vectors in codes of the control.",
            110,
        ),
    ]


def fit_in_words(fit: FixedObserverFit) -> str:
    """What is proven of an observer and what one code of its estimates is, in words."""
    return (
        f"{fit.observer.format}: {len(fit.reaches)} products and sums never overflow, codes of "
        f"{math.degrees(fit.angle_step):.3g} deg and {in_rpm(fit.speed_step):.3g} rpm"
    )


def fixed_observer_files(design: Design, fit: FixedObserverFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    observer = fit.observer
    context = {
        **title(design),
        "format": observer.format,
        "width": observer.width,
        "code": observer.method.code,
        "gains": asdict(observer.gains),
        "preamble": _preamble(fit, design),
    }
    prefix, macro, core = context["prefix"], context["macro"], fit.sine.width
    context["types"] = code_types(prefix, macro, observer.width)
    context["core_types"] = code_types(prefix, macro, core, "core")
    error = error_words(core, fit.sine_error)
    context["core_basics"] = code_basics(prefix, macro, core, error, "core")
    context["text"] = integer_observer_text(
        observer.method, observer.gains, observer.width, context["prefix"], context["macro"]
    )
    inputs = row_inputs(observer, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, row_results(observer, inputs)], axis=1)
    text = render("fixed_observers/observer.h.j2", context)
    return fixed_observer_harness(observer).files(design, text, vectors)


def fixed_observer_harness(observer: FixedPositionObserver) -> Harness:
    """One sample from a given state; where it has not started, the start and the first sample."""
    f, code, words, width = (
        observer.format,
        observer.method.code,
        observer.method.words,
        observer.width,
    )
    number, rest, first = f"int{width}_t", 32 - width, 3 + len(words)
    v, i = (", ".join(f"({number})in[{first + k}]" for k in (begin, begin + 1)) for begin in (0, 2))
    ends = ("(int64_t)observer.theta_e", "observer.omega_m")
    results = [
        "(int64_t)observer.theta",
        "observer.omega",
        *(f"observer.{w.name}" for w in words),
        *ends,
    ]
    body = (
        f"const @_alphabeta_{f}_t v = {{ {v} }};",
        f"const @_alphabeta_{f}_t i = {{ {i} }};",
        f"@_{code}_{f}_t observer;",
        "",
        f"@_{code}_start_{f}(&observer, (u{number})(in[1] >> {rest}),",
        f"        ({number})(in[2] >> {rest}));",
        "if (in[0] != 0) {",
        "    observer.theta = (uint32_t)in[1];",
        "    observer.omega = (int32_t)in[2];",
        *(f"    observer.{w.name} = ({w.type})in[{k}];" for k, w in enumerate(words, 3)),
        "    observer.started = 1U;",
        "}",
        f"@_{code}_step_{f}(&@@_{code.upper()}_GAINS_{f.upper()}, &observer, v, i);",
        *(f"out[{k}] = {result};" for k, result in enumerate(results)),
    )
    told = f"{', '.join(input_names(observer))}; {', '.join(output_names(observer))}"
    return Harness(f"observer_{f}", told, (first + 4, len(results)), body, "int64_t")


def fixed_observer_programme(observer: FixedPositionObserver) -> Programme:
    """The harness of an observer in fixed point, with what its model answers."""
    inputs = row_inputs(observer, SWEEP_POINTS, SWEEP_SEED)
    results = row_results(observer, inputs).astype("i8")
    harness = fixed_observer_harness(observer)
    return Programme(harness, inputs.astype("i8"), results, "fixed-point position observer")


# The position observer in fixed point, as a record.

Fits = tuple[FixedObserverFit, ...]


_KINDS: tuple[HeaderKind[Fits, FixedPositionObserver], ...] = integer_kinds(
    "observer",
    width_of=lambda fit: fit.observer.width,
    files=lambda solution, fit: fixed_observer_files(solution.design, fit),
    plain=lambda fit: plain_fixed_observer(fit.observer),
    read=lambda own, width, _: fixed_observer_from(own, width),
    programme=fixed_observer_programme,
)


def _summary(_: Solution, fits: Fits) -> list[tuple[str, str]]:
    return [("observer in integers", "; ".join(fit_in_words(fit) for fit in fits))]


FIXED_OBSERVER = Capability(
    name="observer_fixed",
    title="position observer in fixed point",
    of=lambda outcome: outcome.solution.fixed_observers or None,
    plain=lambda _, fits: {fit.observer.format: plain_observer_evidence(fit) for fit in fits},
    always=False,
    summary=_summary,
    headers=_KINDS,
)
