"""Duty cycles in single precision: volt-seconds between phases, which phase rests at which rail,
and what no voltage and no link make.
"""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.float_control.duties import Duties, centred_duties
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta

COUNT = 20_000
NAMES = get_args(ModulationName)


def drawn(name: ModulationName) -> tuple[AlphaBeta, Any, AlphaBeta]:
    """Voltages within the linear range, links and currents."""
    generator = np.random.default_rng(11)
    v_dc = generator.uniform(20.0, 800.0, COUNT)
    size = v_dc * MODULATORS[name].linear_limit * generator.uniform(0.01, 0.999, COUNT)
    angle = generator.uniform(-np.pi, np.pi, COUNT)
    values = (size * np.cos(angle), size * np.sin(angle), v_dc, *generator.normal(size=(2, COUNT)))
    alpha, beta, link, i_alpha, i_beta = (x.astype(np.float32) for x in values)
    return AlphaBeta(alpha, beta), link, AlphaBeta(i_alpha, i_beta)


def phases(vector: AlphaBeta) -> NDArray[np.float64]:
    """Projections of a vector on the axes of the phases, shape (3, N)."""
    axes = 2.0 * np.pi / 3.0 * np.array([0.0, 1.0, -1.0])[:, np.newaxis]
    return np.asarray(
        vector.alpha.astype(np.float64) * np.cos(axes)
        + vector.beta.astype(np.float64) * np.sin(axes)
    )


@pytest.mark.parametrize("name", NAMES)
def test_differences_of_the_duty_cycles_make_those_of_the_phases(name: ModulationName) -> None:
    voltage, v_dc, i = drawn(name)
    duty = np.array(Duties(name).duties(SINGLE, voltage, v_dc, i))
    v = phases(voltage) / v_dc
    assert np.all((duty >= 0.0) & (duty <= 1.0))
    for k in range(3):
        np.testing.assert_allclose(duty[k] - duty[k - 1], v[k] - v[k - 1], atol=6e-7)


@pytest.mark.parametrize("name", NAMES)
def test_the_zero_sequence_is_that_of_the_modulator(name: ModulationName) -> None:
    voltage, v_dc, i = drawn(name)
    duty = np.array(Duties(name).duties(SINGLE, voltage, v_dc, i), dtype=np.float64)
    v, rule = phases(voltage) / v_dc, MODULATORS[name]
    top, bottom = np.max(duty, axis=0), np.min(duty, axis=0)
    up, down = np.abs(top - 1.0) < 6e-7, np.abs(bottom) < 6e-7
    if rule.kind == "centred":
        np.testing.assert_allclose(top + bottom, 1.0, atol=6e-7)
    elif rule.kind in ("sine", "third-harmonic"):
        size = np.hypot(voltage.alpha, voltage.beta) / v_dc
        angle = np.arctan2(voltage.beta, voltage.alpha)
        share = rule.share if rule.kind == "third-harmonic" else 0.0
        mean = 0.5 - share * size * np.cos(3.0 * angle)
        np.testing.assert_allclose(np.mean(duty, axis=0), mean, atol=6e-7)
    elif rule.kind in ("highest", "lowest"):
        assert np.all(up if rule.kind == "highest" else down)
    else:
        assert np.all(up | down)
        seen = phases(i) if rule.compared == "currents" else _seen(name, voltage, i)
        high, low = np.argmax(v, axis=0), np.argmin(v, axis=0)
        of_high, of_low = (np.abs(seen[k, np.arange(COUNT)]) for k in (high, low))
        clear = np.abs(of_high - of_low) > 1e-5 * np.max(np.abs(seen), axis=0)
        larger_rests = np.where(of_high > of_low, up, down)
        smaller_rests = np.where(of_high > of_low, down, up)
        assert np.all((smaller_rests if rule.smaller else larger_rests)[clear])
        assert 0.2 < np.mean(up) < 0.8


def _seen(name: ModulationName, voltage: AlphaBeta, i: AlphaBeta) -> NDArray[np.float64]:
    """Phases of the voltage as they are compared: turned back by the modulator's angle."""
    vector = voltage.alpha.astype(np.float64) + 1j * voltage.beta
    current = i.alpha.astype(np.float64) + 1j * i.beta
    rule = MODULATORS[name]
    lag: Any = 0.0
    if rule.compared == "load angle":
        along = vector * np.conj(current)
        lag = np.angle(np.where(along.real < 0.0, -along, along))
        lag = np.clip(lag, -np.pi / 6.0, np.pi / 6.0)
    elif rule.delay is not None:
        lag = np.arctan2(rule.delay.y, rule.delay.x)
    turned = vector * np.exp(-1j * lag)
    return phases(AlphaBeta(turned.real, turned.imag))


@pytest.mark.parametrize("name", NAMES)
def test_without_a_link_all_rest_in_the_middle_and_no_number_leaves_the_range(
    name: ModulationName,
) -> None:
    one, none = np.ones(3, dtype=np.float32), np.array([0.0, -1.0, np.nan], dtype=np.float32)
    with np.errstate(all="ignore"):
        duty = np.array(Duties(name).duties(SINGLE, AlphaBeta(one, one), none, AlphaBeta(one, one)))
        bad = AlphaBeta(none, one * np.float32(np.nan))
        spoilt = np.array(Duties(name).duties(SINGLE, bad, one, AlphaBeta(one, one)))
    np.testing.assert_array_equal(duty, np.full((3, 3), 0.5))
    assert np.all((spoilt >= 0.0) & (spoilt <= 1.0))


def test_centred_duties_are_a_half_each_without_voltage() -> None:
    v_dc, none = np.array([300.0, 0.0, -1.0], dtype=np.float32), np.zeros(3, dtype=np.float32)
    with np.errstate(all="ignore"):
        duty = centred_duties(SINGLE, AlphaBeta(none, none), v_dc)
    np.testing.assert_array_equal(duty, np.full((3, 3), 0.5))
