"""Rows of integers through the control of a phase machine: inputs that reach the ends, and what
must come out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.fixed_control.transforms import IDLE, speed_loop
from dqforge.optimizer.fixed_phase_control.design import phase_ranges
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedMidpoint,
    FixedPhaseControl,
    Measured,
    Turning,
    phase_at_rest,
    phase_gains,
)
from dqforge.optimizer.fixed_phase_control.phase_step import PhaseSteps
from dqforge.optimizer.steps.code_vectors import Abc, Dq
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers
from dqforge.reports.control.fixed_model import (
    NOT_OURS,
    forms_from,
    gain_from,
    one_of,
    positive,
    whole,
)

_MEASURED = ("i_a", "i_b", "i_c", "theta", "omega", "v_dc", "v_m", "open", "torque", "d", "q")


_SPEED = ("speed_reference", "speed_filtered", "speed_integral", "speed_torque", "speed_count")


_SPEED_RESULTS = (*_SPEED[1:], "speed_omega", "sinusoid_q")


_INTEGRALS = ("integral_d", "integral_q", "integral_0")


_VECTORS = ("v_alpha", "v_beta", "v_0", "reference_alpha", "reference_beta", "reference_0")


def _states(control: FixedPhaseControl) -> tuple[str, ...]:
    names = [f"harmonic_{k}{axis}" for k in range(len(control.harmonics)) for axis in "xy"]
    return (*_INTEGRALS, *names)


def phase_inputs(control: FixedPhaseControl) -> tuple[str, ...]:
    """Columns of the inputs: what is measured and wanted, then the state."""
    return (*_MEASURED, *_SPEED, *_states(control))


def phase_outputs(control: FixedPhaseControl) -> tuple[str, ...]:
    """Columns of the results: duty cycles, the next state, voltage and reference."""
    legs = (f"duty_{leg}" for leg in TOPOLOGIES[control.topology].legs)
    return (*legs, *_states(control), *_VECTORS, *_SPEED_RESULTS)


def _columns(control: FixedPhaseControl) -> dict[str, tuple[int, int]]:
    """Least and largest value of each input."""
    top = control.top
    found = dict.fromkeys(phase_inputs(control), (-top - 1, top))
    found |= {
        "theta": (0, 2**control.width - 1),
        "v_m": (0, top),
        "open": (0, 3 if TOPOLOGIES[control.topology].neutral else 0),
        # Without a table the step takes no torque.
        "torque": (0, 0) if control.frame == "dq" else (-top - 1, top),
    }
    for name, axis in zip(_INTEGRALS, (control.d, control.q, control.zero), strict=True):
        most = 0 if axis is None else top << axis.fraction
        found[name] = (-most, most)
    fraction = IDLE.fraction if control.speed is None else control.speed["parallel"].fraction
    filtered, integral = top << (control.width - 2), top << fraction
    found["speed_filtered"], found["speed_integral"] = (-filtered, filtered), (-integral, integral)
    found["speed_count"] = (0, control.ratio - 1)
    most = top << control.harmonic_fraction
    return found | dict.fromkeys(_states(control)[3:], (-most, most))


def phase_rows(control: FixedPhaseControl, count: int, seed: int) -> CodeArray:
    """Inputs of shape (count, columns).

    A third near the middle of an operating drive, a third anywhere, a third at the ends of words
    and near zero. In 16 bits every angle comes once in 65,536 rows.
    """
    generator = np.random.default_rng(seed)
    kind, columns = generator.integers(0, 3, count), []
    for name, (low, high) in _columns(control).items():
        if name in ("open", "speed_count"):
            columns.append(generator.integers(low, high, count, endpoint=True))
            continue
        even = generator.integers(low, high, count, endpoint=True)
        ends = generator.choice(
            np.array([low, min(low + 1, high), 0, max(high - 1, low), high]), count
        )
        small = low // 64 if low < 0 else high // 2
        calm = generator.integers(min(small, high), high // 64 + high // 2 + 1, count)
        near = even // 32 if low < 0 else np.clip(calm, low, high)
        columns.append(np.choose(kind, [near, even, np.clip(ends, low, high)]))
    rows = np.stack(columns, axis=1)
    if control.width == 16:
        rows[:, phase_inputs(control).index("theta")] = (np.arange(count) * 40_503) % 65_536
    return rows


def phase_results(
    control: FixedPhaseControl, inputs: CodeArray, arithmetic: Integers | None = None
) -> CodeArray:
    """Results of one step for rows of inputs, shape (rows, results), columns as `phase_outputs`."""
    o, steps = Integers() if arithmetic is None else arithmetic, PhaseSteps(control)
    x = dict(zip(phase_inputs(control), inputs.T, strict=True))
    gains, state = phase_gains(control), phase_at_rest(control, o.const(0))
    measured = Measured(
        Abc(x["i_a"], x["i_b"], x["i_c"]),
        x["theta"],
        x["omega"],
        x["v_dc"],
        x["v_m"] if control.midpoint else None,
    )
    names = _states(control)[3:]
    a, b, c = (x[name] for name in _INTEGRALS)
    pairs = zip(names[::2], names[1::2], strict=True)
    state.integral = (a, b, c)
    state.harmonic = tuple(Turning(x[m], x[n]) for m, n in pairs)
    state.open_phase = x["open"]
    duty = steps.shaped_control(o, gains, state, measured, x["torque"], Dq(x["d"], x["q"]))
    integrals = [*state.integral, *(v for held in state.harmonic for v in (held.x, held.y))]
    state.speed.integral, state.filtered = x["speed_integral"], x["speed_filtered"]
    state.torque, state.count = x["speed_torque"], x["speed_count"]
    torque = speed_loop(o, control.width, gains, state, x["omega"], x["speed_reference"])
    sinusoid = steps.references.sinusoids(o, gains, torque)
    speed = (state.filtered, state.speed.integral, state.torque, state.count, state.omega_m)
    found = [*duty, *integrals, *state.v, *state.reference, *speed, sinusoid.y]
    shape = inputs.shape[:1]
    return np.stack([np.broadcast_to(value, shape) for value in found], axis=1)


# The control of phases in fixed point read back from ``result.json``, and proven again not to
# overflow.


def _axis(plain: Mapping[str, Any], width: int) -> FixedAxis:
    names = ("kp", "ki", "resistance", "inductance", "reactance")
    return FixedAxis(
        **{name: gain_from(plain[name], width) for name in names},
        fraction=whole(plain["fraction"], 0, width - 1),
    )


def _harmonic(plain: Mapping[str, Any], width: int) -> FixedHarmonic:
    return FixedHarmonic(
        order=whole(plain["order"], -99, 99),
        zero=bool(plain["zero"]),
        reactance=gain_from(plain["reactance"], width),
        fade=gain_from(plain["fade"], width),
        end=whole(plain["end"], 1, 2 << width),
    )


def _shape(plain: Any, width: int) -> tuple[tuple[int, ...], ...]:
    top = 2 ** (width - 1) - 1
    rows = tuple(tuple(whole(value, -top, top) for value in row) for row in plain)
    sizes = {len(row) for row in rows}
    if len(rows) not in (1, 3) or len(sizes) != 1 or not 25 <= sizes.pop() <= 2**14:
        raise ValueError(len(rows))
    return rows


def phase_integers_from(plain: Mapping[str, Any], width: int) -> FixedPhaseControl:
    """Read the control in words of ``width`` bits back, and prove again that nothing overflows.

    Raises:
        InputError: The data are not what `plain_phase_integers` makes.
    """
    code = 2 ** (width - 1)
    gains = ("fade", "unit", "sample", "electrical", "rate")
    middle = plain.get("midpoint")
    try:
        current, voltage, speed, torque, flux = positive(plain["bases"], 5)
        found = FixedPhaseControl(
            **{name: gain_from(plain[name], width) for name in gains},
            width=whole(plain["width"], width, width),
            bases=(current, voltage, speed, torque, flux),
            frame=one_of(plain["frame"], get_args(CurrentFrame)),
            feedforward=one_of(plain["feedforward"], get_args(Feedforward)),
            topology=one_of(plain["topology"], get_args(Topology)),
            shape=_shape(plain["shape"], width),
            turns=whole(plain["turns"], 1, 200),
            fundamental=whole(plain["fundamental"], -code + 1, code - 1),
            fade_end=whole(plain["fade_end"], 0, 4 * code),
            unit_bits=whole(plain["unit_bits"], 0, width - 1),
            least_square=whole(plain["least_square"], 1, 4 * code),
            d=_axis(plain["d"], width),
            q=_axis(plain["q"], width),
            zero=None if plain["zero"] is None else _axis(plain["zero"], width),
            harmonic_fraction=whole(plain["harmonic_fraction"], 0, width - 1),
            error_max=whole(plain["error_max"], 0, 16 * code),
            harmonics=tuple(_harmonic(part, width) for part in plain["harmonics"]),
            midpoint=None
            if middle is None
            else FixedMidpoint(
                gain_from(middle["balance"], width), gain_from(middle["fade"], width)
            ),
            dc_scale=whole(plain["dc_scale"], 0, 8),
            dc_least=whole(plain["dc_least"], 1, code - 1),
            current_per_torque=gain_from(plain["current_per_torque"], width),
            speed=None if plain["speed"] is None else forms_from(plain["speed"], width),
            speed_filter=gain_from(plain["speed_filter"], width),
            torque_max=whole(plain["torque_max"], 0, code - 1),
            ratio=whole(plain["ratio"], 1, 2**31 - 1),
        )
        phase_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, NoSolutionError):
        raise NOT_OURS from None
    return found
