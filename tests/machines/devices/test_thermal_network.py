"""Foster and Cauer networks against each other, against a state-space simulation and
against hand calculation.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import StateSpace, lsim, step

from dqforge.machines.devices.thermal_network import CauerNetwork, FosterNetwork
from dqforge.machines.errors import InputError

FUJI = FosterNetwork((0.00214, 0.01713, 0.02542, 0.0353), (0.0005, 0.0049, 0.0351, 0.0566))
TIMES = np.logspace(-6, 2, 200)


def test_one_element_by_hand() -> None:
    ladder = FosterNetwork((0.5,), (0.01,)).cauer()
    assert ladder.resistances == (0.5,)
    assert ladder.capacities == pytest.approx((0.02,), rel=1e-15)
    assert ladder.step_response(0.01) == pytest.approx(0.5 * (1.0 - math.exp(-1.0)), rel=1e-14)


def test_two_elements_by_hand() -> None:
    """C_1 = 1 / sum(1/C_i) of the Foster elements: all of the first moment is at the junction."""
    foster = FosterNetwork((1.0, 2.0), (1.0, 4.0))
    ladder = foster.cauer()
    assert ladder.capacities[0] == pytest.approx(1.0 / (1.0 / 1.0 + 2.0 / 4.0), rel=1e-15)
    assert ladder.resistance == pytest.approx(3.0, rel=1e-15)


def test_ladder_against_a_state_space_simulation() -> None:
    ladder = FUJI.cauer()
    size = len(ladder.resistances)
    source = np.zeros((size, 1))
    source[0] = 1.0 / ladder.capacities[0]
    system = StateSpace(ladder.matrix(), source, np.eye(1, size), 0.0)
    time = np.linspace(0.0, 0.5, 4001)
    _, answer = step(system, T=time)
    assert answer == pytest.approx(FUJI.step_response(time), rel=1e-9, abs=1e-12)
    assert answer == pytest.approx(ladder.step_response(time), rel=1e-9, abs=1e-12)
    # A burst of power and its absence: superposition of two steps.
    _, burst, _ = lsim(system, np.where(time < 0.1, 100.0, 0.0), time, interp=False)
    expected = 100.0 * (
        FUJI.step_response(time) - np.where(time >= 0.1, FUJI.step_response(time - 0.1), 0.0)
    )
    assert burst == pytest.approx(expected, rel=1e-8, abs=1e-9)


elements = st.lists(st.tuples(st.floats(1e-3, 2.0), st.floats(0.05, 1.2)), min_size=1, max_size=6)


@given(elements, st.floats(1e-6, 1e-2))
def test_round_trip_of_any_network(drawn: list[tuple[float, float]], fastest: float) -> None:
    """Time constants at least 12 % apart, over up to seven decades."""
    constants = fastest * np.cumprod([10.0**gap for _, gap in drawn])
    foster = FosterNetwork(tuple(r for r, _ in drawn), tuple(constants.tolist()))
    back = foster.cauer().foster()
    assert back.resistance == pytest.approx(foster.resistance, rel=1e-12)
    grid = np.logspace(-1, 1, 41)[:, None] * constants
    assert back.step_response(grid) == pytest.approx(foster.step_response(grid), rel=1e-10)
    assert len(back.resistances) == len(drawn)


def test_round_trip_of_a_data_sheet() -> None:
    back = FUJI.cauer().foster()
    assert back.resistances == pytest.approx(FUJI.resistances, rel=1e-10)
    assert back.time_constants == pytest.approx(FUJI.time_constants, rel=1e-10)
    assert back.step_response(TIMES) == pytest.approx(FUJI.step_response(TIMES), rel=1e-10)


def test_equal_time_constants_are_one_pole() -> None:
    ladder = FosterNetwork((0.2, 0.3), (0.1, 0.1)).cauer()
    assert ladder.resistances == pytest.approx((0.5,))
    assert ladder.step_response(TIMES) == pytest.approx(
        FosterNetwork((0.5,), (0.1,)).step_response(TIMES)
    )


def test_resistance_alone_rises_at_once_and_has_no_ladder() -> None:
    bare = FosterNetwork((0.3,), (0.0,))
    assert bare.step_response([0.0, 1.0]) == pytest.approx([0.3, 0.3])
    with pytest.raises(InputError, match="write tau"):
        bare.cauer()


@pytest.mark.parametrize(
    ("resistances", "seconds"),
    [
        ((), ()),
        ((1.0,), (1.0, 2.0)),
        ((0.0,), (1.0,)),
        ((1.0,), (-1.0,)),
        ((math.nan,), (1.0,)),
        ((1.0,), (math.inf,)),
    ],
)
def test_impossible_networks(resistances: tuple[float, ...], seconds: tuple[float, ...]) -> None:
    for network in (FosterNetwork, CauerNetwork):
        with pytest.raises(InputError, match="write"):
            network(resistances, seconds)


def test_ladder_without_capacity_is_refused() -> None:
    with pytest.raises(InputError, match="positive"):
        CauerNetwork((1.0,), (0.0,))
