"""Public constructors refuse what a design file refuses, and objects print in a few lines."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dqforge
from dqforge.machines.errors import InputError

AXIS = np.linspace(-30.0, 30.0, 9)
GRID = np.meshgrid(AXIS, AXIS, indexing="ij")
MAP = dqforge.FluxMap(AXIS, AXIS, 0.1 + 2e-3 * GRID[0], 3e-3 * GRID[1])
WAVE = np.sin(np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False) - np.array([[0.0], [2.1], [4.2]]))
COMMON: dict[str, Any] = {"pole_pairs": 3, "r_s": 0.5, "i_max": 20.0}
MECHANICAL: dict[str, Any] = {"inertia": 1e-3, "friction": 0.0, "omega_m_max": 300.0}
MADE: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
    "linear": (
        dqforge.LinearMachine,
        COMMON | MECHANICAL | {"l_d": 1e-3, "l_q": 2e-3, "psi_pm": 0.1},
    ),
    "saturated": (dqforge.SaturatedMachine, COMMON | MECHANICAL | {"flux_map": MAP}),
    "phases": (dqforge.PhaseMachine, COMMON | {"l_s": 1e-3, "m_s": -1e-4, "flux": WAVE}),
}
BAD = ["2.35 Ohm", math.nan, math.inf, -1e-3, True, [1.0], np.ones(2), object(), 1j, b"1", {}]
CASES = [(made, name) for made, (_, values) in MADE.items() for name in values]


@pytest.mark.parametrize(("made", "name"), CASES)
def test_constructors_refuse_what_is_no_such_number(made: str, name: str) -> None:
    make, values = MADE[made]
    make(**values)
    bad = [*BAD, 3.5] if name == "pole_pairs" else BAD
    for value in bad:
        if (
            name == "m_s" and isinstance(value, float) and value == -1e-3
        ):  # two phases usually couple the other way
            continue
        with pytest.raises(InputError, match=name if made != "phases" else ".") as refused:
            make(**(values | {name: value}))
        assert "\n" not in str(refused.value)


def test_numbers_of_numpy_are_taken() -> None:
    numbers: list[Any] = [np.int64(3), np.float32(0.5), 1e-3, 2e-3, np.float64(0.1), 20]
    made = dqforge.LinearMachine(*numbers)
    assert made.torque_per_ampere == pytest.approx(0.45)


def test_objects_print_in_ten_lines() -> None:
    drives = [dqforge.load_design(name) for name in ("baldor-pmsyrm-5k6", "vdyno-trampa-6340")]
    objects: list[object] = [make(**values) for make, values in MADE.values()]
    objects += [MAP, *drives, *(drive.machine for drive in drives)]
    objects += [dqforge.operating_points(drives[0], torque=np.linspace(0.0, 10.0, 40))]
    objects += [dqforge.characteristics(drives[0])]
    for thing in objects:
        text = repr(thing)
        assert text.count("\n") < 10
        assert len(text) <= 1200
        assert type(thing).__name__ in text
