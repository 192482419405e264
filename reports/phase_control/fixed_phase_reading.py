"""The control of phases in fixed point read back from ``result.json``, and proven again not to
overflow.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.optimizer.fixed_phase_control.design import phase_ranges
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedMidpoint,
    FixedPhaseControl,
)
from dqforge.reports.control.fixed_reading import (
    NOT_OURS,
    forms_from,
    gain_from,
    one_of,
    positive,
    whole,
)


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
