"""Rows of integers through all control functions in fixed point: inputs that reach the ends,
and what must come out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, get_args

import numpy as np

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.transforms import Triple
from dqforge.optimizer.fixed_control.codes import (
    code_clarke,
    code_clarke_inverse,
    code_park,
    code_park_inverse,
    full_scale,
    rotation,
)
from dqforge.optimizer.fixed_control.ranges import control_ranges
from dqforge.optimizer.fixed_control.transforms import (
    Control,
    FixedControl,
    FixedDecoupling,
    FixedObserver,
    FixedPi,
    FixedReferences,
    Measured,
    Pi,
    PiForm,
    PiVelocity,
    ReducedOrder,
    control_at_rest,
    decoupling,
    pi_gains,
    pi_step,
    pi_velocity_step,
    reduced_order_gains,
    reduced_order_step,
    speed_loop,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers

_LOOP_INPUTS = ("integral", "output", "proportional")


_LOOP_OUTPUTS = ("limited", "integral", "velocity", "output", "proportional")


_SPEED_INPUTS = ("filtered", "torque", "count", "speed_ref")


_SPEED_OUTPUTS = ("torque", "filtered", "omega", "integral", "count")


_STEP_OUTPUTS = (
    "duty_a",
    "duty_b",
    "duty_c",
    "integral_d",
    "integral_q",
    "alpha",
    "beta",
    "d",
    "q",
    "v_d",
    "v_q",
)


def input_names(control: FixedControl) -> tuple[str, ...]:
    """Columns of the inputs: measured values, references, a vector, an error,
    states of the loops and the observer.
    """
    names = [
        "i_a",
        "i_b",
        "i_c",
        "theta",
        "omega",
        "v_dc",
        "ref_d",
        "ref_q",
        "x",
        "y",
        "error",
        "limit",
    ]
    names += [f"{loop}_{part}" for loop in control.loops for part in _LOOP_INPUTS]
    names += _SPEED_INPUTS
    return (
        *names,
        *(("zeta", "omega_hat", "last_d", "last_q") if control.observer is not None else ()),
    )


def output_names(control: FixedControl) -> tuple[str, ...]:
    """Columns of the results, in the order of `row_results`."""
    names = ["cosine", "sine", "clarke_alpha", "clarke_beta", "inverse_a", "inverse_b", "inverse_c"]
    names += ["park_d", "park_q", "back_alpha", "back_beta", "feed_d", "feed_q"]
    names += [f"{loop}_{part}" for loop in control.loops for part in _LOOP_OUTPUTS]
    names += ["next_zeta", "next_omega_hat"] if control.observer is not None else []
    names += [f"speed_loop_{part}" for part in _SPEED_OUTPUTS]
    names += [f"step_{part}" for part in _STEP_OUTPUTS]
    if control.reference is not None:
        names += [f"torque_{part}" for part in ("ref_d", "ref_q", *_STEP_OUTPUTS)]
        names += [f"whole_{part}" for part in _STEP_OUTPUTS]
    return tuple(names)


def proportional_reach(control: FixedControl, pi: FixedPi) -> int:
    """Largest kp e in codes that a loop can have kept."""
    largest = pi.kp.mantissa * (2**control.width - 1) + pi.kp.half
    return int(largest >> pi.kp.shift)


def _columns(control: FixedControl) -> dict[str, tuple[int, int]]:
    """Least and largest value of each input."""
    width, top = control.width, full_scale(control.width)
    code = (-top - 1, top)
    found = dict.fromkeys(input_names(control), code)
    found |= {"theta": (0, 2**width - 1), "error": (1 - 2**width, 2**width - 1), "limit": (0, top)}
    for loop, forms in control.loops.items():
        for name, pi in (("integral", forms["parallel"]), ("output", forms["velocity"])):
            found[f"{loop}_{name}"] = (-top << pi.fraction, top << pi.fraction)
        most = proportional_reach(control, forms["velocity"])
        found[f"{loop}_proportional"] = (-most, most)
    fine = top << (width - 2)
    found |= {"filtered": (-fine, fine), "count": (0, control.ratio - 1)}
    if control.observer is not None:
        most = control.observer.reach * top << control.observer.fraction
        found["zeta"] = (-most, most)
    return found


def row_inputs(control: FixedControl, count: int, seed: int) -> CodeArray:
    """Inputs of shape (count, columns): two thirds spread evenly, one at the ends
    of the words and near zero.

    The phase currents of a third of the rows are balanced. In 16 bits every angle
    comes once in 65,536 rows.
    """
    generator = np.random.default_rng(seed)
    columns = []
    for low, high in _columns(control).values():
        even = generator.integers(low, high, count, endpoint=True)
        special = generator.choice(np.array([low, low + 1, -1, 0, 1, high - 1, high]), count)
        some = generator.random(count) < 1.0 / 3.0
        columns.append(np.where(some, np.clip(special, low, high), even))
    rows = np.stack(columns, axis=1)
    names = input_names(control)
    _balance(rows, generator, full_scale(control.width))
    if control.width == 16:
        rows[:, names.index("theta")] = (
            np.arange(count) * 40_503
        ) % 65_536  # an odd step: all of them in turn
    _calm(control, rows, generator)
    return rows


def _calm(control: FixedControl, rows: CodeArray, generator: np.random.Generator) -> None:
    """Let the references of a sixth of the rows be near the currents, at a part of the integrals,
    so that the voltage is within its limit and just beyond it.
    """
    names, o = input_names(control), Integers()
    some = rows[: rows.shape[0] // 6]
    column = {name: some[:, k] for k, name in enumerate(names)}
    width, top = control.width, full_scale(control.width)
    fixed = code_clarke(o, width, Abc(column["i_a"], column["i_b"], column["i_c"]))
    current = code_park(o, width, fixed, rotation(o, width, column["theta"]))
    for name, value in (("ref_d", current.x), ("ref_q", current.y)):
        noise = np.rint(generator.normal(size=value.shape) * top / 300).astype(np.int64)
        column[name][:] = np.clip(value + noise, -top - 1, top)
    for name in ("i_d_integral", "i_q_integral", "omega"):
        column[name][:] //= 4


def _balance(rows: CodeArray, generator: np.random.Generator, top: int) -> None:
    """Make the phase currents of a third of the rows balanced, and let a part
    of them have equal phases.
    """
    third = slice(0, rows.shape[0] // 3)
    count = rows[third].shape[0]
    angle = generator.integers(0, 12, count) * (np.pi / 6.0) + generator.choice([0.0, 0.3], count)
    size = np.exp(generator.uniform(-9.0, 0.0, count)) * top
    for phase in range(3):
        rows[third, phase] = np.rint(size * np.cos(angle - phase * 2.0 * np.pi / 3.0))


def row_results(
    control: FixedControl, inputs: CodeArray, arithmetic: Integers | None = None
) -> CodeArray:
    """Results of every function for rows of inputs, shape (rows, results),
    columns as `output_names`.
    """
    o = Integers() if arithmetic is None else arithmetic
    column = dict(zip(input_names(control), inputs.T, strict=True))
    return np.stack(list(_results(o, control, column)), axis=1)


def _results(o: Integers, control: FixedControl, x: dict[str, CodeArray]) -> Iterator[CodeArray]:
    width = control.width
    phases, vector = Abc(x["i_a"], x["i_b"], x["i_c"]), AlphaBeta(x["x"], x["y"])
    reference, turned = Dq(x["ref_d"], x["ref_q"]), Dq(x["x"], x["y"])
    turn = rotation(o, width, x["theta"])
    yield from turn
    yield from code_clarke(o, width, phases)
    yield from code_clarke_inverse(o, width, vector)
    yield from code_park(o, width, vector, turn)
    yield from code_park_inverse(o, width, turned, turn)
    yield from decoupling(o, width, control.decoupling, x["omega"], turned)
    for loop, forms in control.loops.items():
        pi, gains = Pi(x[f"{loop}_integral"]), pi_gains(width, forms["parallel"])
        yield pi_step(o, gains, pi, x["error"], x["limit"])
        yield pi.integral
        velocity = PiVelocity(x[f"{loop}_output"], x[f"{loop}_proportional"])
        gains = pi_gains(width, forms["velocity"])
        yield pi_velocity_step(o, gains, velocity, x["error"], x["limit"])
        yield from (velocity.output, velocity.proportional)
    if control.observer is not None:
        seen = ReducedOrder(x["zeta"], x["omega_hat"], Dq(x["last_d"], x["last_q"]))
        own = reduced_order_gains(width, control.observer)
        reduced_order_step(o, width, own, seen, turned, reference)
        yield from (seen.zeta, seen.omega_m)
    yield from _whole(o, control, x, Measured(phases, x["theta"], x["omega"], x["v_dc"]), reference)


def _whole(
    o: Integers,
    control: FixedControl,
    x: dict[str, CodeArray],
    measured: Measured[CodeArray],
    reference: Dq[CodeArray],
) -> Iterator[CodeArray]:
    """Columns of the speed loop and of the control as a whole."""
    gains, steps, state = control.gains, control.steps, control_at_rest(np.zeros_like(x["count"]))

    def begin(*, speed: bool) -> None:
        state.d.integral, state.q.integral = x["i_d_integral"], x["i_q_integral"]
        if speed:
            state.speed.integral = x.get("speed_integral", state.speed.integral)
            state.filtered, state.torque, state.count = x["filtered"], x["torque"], x["count"]

    begin(speed=True)
    yield speed_loop(o, control.width, gains, state, x["omega"], x["speed_ref"])
    yield from (state.filtered, state.omega_m, state.speed.integral, state.count)
    begin(speed=False)
    duty = steps.current_control(o, gains, state, measured, reference)
    yield from _step(duty, state)
    if control.reference is not None:
        begin(speed=False)
        duty = steps.torque_control(o, gains, state, measured, x["torque"])
        yield from state.reference
        yield from _step(duty, state)
        begin(speed=True)
        duty = steps.speed_control(o, gains, state, measured, x["speed_ref"])
        yield from _step(duty, state)


def _step(duty: Triple[CodeArray], state: Control[CodeArray]) -> Iterator[CodeArray]:
    """Columns of a step, as `_STEP_OUTPUTS`."""
    yield from duty
    yield from (state.d.integral, state.q.integral)
    for pair in (state.v, state.i, state.v_dq):
        yield from pair


# Control functions in fixed point read back from ``result.json``, and proven again not to
# overflow.

NOT_OURS = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def fixed_control_from(
    plain: Mapping[str, Any], width: int, reference: FixedReferences | None = None
) -> FixedControl:
    """Read control functions in words of ``width`` bits back, and prove again that nothing
    overflows.

    ``reference`` are the current references of their own header, where they have some.

    Raises:
        InputError: The data are not what `plain_fixed_control` makes.
    """
    try:
        current, voltage, speed, torque = positive(plain["bases"], 4)
        found = FixedControl(
            width=one_of(plain["width"], (width,)),
            bases=(current, voltage, speed, torque),
            modulation=one_of(
                plain["modulation"],
                tuple(MODULATORS),
            ),
            dc_scale=whole(plain["dc_scale"], 0, 8),
            dc_least=whole(plain["dc_least"], 1, full_scale(width)),
            limit=gain_from(plain["limit"], width),
            advance=gain_from(plain["advance"], width),
            i_d=forms_from(plain["i_d"], width),
            i_q=forms_from(plain["i_q"], width),
            speed=None if plain["speed"] is None else forms_from(plain["speed"], width),
            decoupling=FixedDecoupling(
                **{k: gain_from(v, width) for k, v in plain["decoupling"].items()}
            ),
            observer=None if plain["observer"] is None else _observer(plain["observer"], width),
            speed_filter=gain_from(plain["speed_filter"], width),
            torque_max=whole(plain["torque_max"], 0, full_scale(width)),
            ratio=whole(plain["ratio"], 1, 2**31 - 1),
            reference=reference,
        )
        one_of(int(plain["reference"]), (int(reference is not None),))
        control_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, NoSolutionError):
        raise NOT_OURS from None
    return found


def one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    """A value that is one of some choices; raises ValueError where it is none."""
    if isinstance(value, bool) or value not in choices:
        raise ValueError(value)
    return value


def whole(value: Any, low: int, high: int) -> int:
    """A whole number within limits; raises ValueError where it is none."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def positive(value: Any, count: int) -> tuple[float, ...]:
    """So many positive numbers; raises TypeError or ValueError where they are not."""
    found = tuple(_real(entry) for entry in value)
    if len(found) != count or not min(found) > 0.0:
        raise ValueError(value)
    return found


def gain_from(plain: Mapping[str, Any], width: int) -> FixedGain:
    """A gain in words of ``width`` bits; KeyError, TypeError or ValueError where it is none."""
    top = full_scale(width)
    return FixedGain(
        whole(plain["mantissa"], -top, top),
        whole(plain["shift"], 0, 2 * width - 2),
        _real(plain["value"]),
    )


def forms_from(plain: Mapping[str, Any], width: int) -> dict[PiForm, FixedPi]:
    """A controller in its forms; KeyError, TypeError or ValueError where it is none."""
    return {
        form: FixedPi(
            **{name: gain_from(plain[form][name], width) for name in ("kp", "ki", "tracking")},
            fraction=whole(plain[form]["fraction"], 0, width - 1),
        )
        for form in get_args(PiForm)
    }


def _observer(plain: Mapping[str, Any], width: int) -> FixedObserver:
    gains = {name: gain_from(plain[name], width) for name in ("decay", "b_u", "b_i", "c", "x_d")}
    return FixedObserver(
        **gains,
        fraction=whole(plain["fraction"], 0, width - 1),
        reach=whole(plain["reach"], 1, 2 ** (width - 1)),
    )
