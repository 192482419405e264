"""Gains as mantissa and shift: the thesis' integers, full words, and
what rounding does to a loop.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    WeakeningSettings,
)
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.design import (
    FixedControlFit,
    _automatic,
    _require_bases,
    fit_control,
    quantised_loop,
    real_pi,
    require_scales,
    velocity_integers,
)
from dqforge.optimizer.loops.integer_gains import FixedGain, given, pi_integers, quantise
from dqforge.optimizer.loops.loop_gains import current_step_response


@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("style", ["power-of-two", "q"])
def test_mantissas_use_their_word(width: int, style: Literal["power-of-two", "q"]) -> None:
    generator = np.random.default_rng(2)
    argument = 2**width - 1
    for value in np.exp(generator.uniform(-9.0, 9.0, 300)) * generator.choice([-1.0, 1.0], 300):
        gain = quantise(float(value), width, argument, style)
        assert abs(gain.mantissa) < 2 ** (width - 1)
        assert abs(gain.mantissa) * argument + gain.half < 2 ** (2 * width - 1)
        assert abs(gain.realised - value) <= 2.0 ** -(gain.shift + 1) * (1.0 + 1e-9)
        most = width - 1 if style == "q" else 2 * width - 2
        assert 0 <= gain.shift <= most
        if gain.shift < most:  # one bit more would not fit
            finer = abs(round(float(value) * 2.0 ** (gain.shift + 1)))
            assert finer >= 2 ** (width - 1) - 1 or finer * argument + 2**gain.shift >= 2 ** (
                2 * width - 1
            )
    assert quantise(0.0, width, argument).realised == 0.0


def test_gains_that_no_word_holds_are_refused() -> None:
    with pytest.raises(NoSolutionError, match="more than int16_t holds"):
        quantise(32768.0, 16, 1)
    with pytest.raises(NoSolutionError, match="is 0 in 16 bits with a shift of 15"):
        quantise(1e-6, 16, 65_535, "q")
    assert quantise(1e-6, 16, 65_535).mantissa > 1000  # a larger divider keeps it


def test_the_integers_of_the_thesis() -> None:
    """Table 8.1 and the program of paper 001: 20000 and 2500 in Q10, 136 in Q10 and 26 in Q15."""
    design = catalogue.load("paper001-pmsm-bench")
    gains = solve_gains(design)
    assert gains.speed is not None
    speed = pi_integers(*real_pi(design, gains.speed), (10, 10))
    current = pi_integers(*real_pi(design, gains.i_q), (10, 15))
    assert speed is not None
    assert current is not None
    assert [(gain.mantissa, gain.shift) for gain in (*speed, *current)] == [
        (20000, 10), (2500, 10), (136, 10), (26, 15),
    ]  # fmt: skip
    fit = fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, 16)
    pi = fit.control.i_q["parallel"]
    assert (pi.kp.mantissa, pi.kp.shift, pi.ki.mantissa, pi.ki.shift + pi.fraction) == (
        136,
        10,
        26,
        15,
    )


def test_automatic_formats_keep_what_the_thesis_has() -> None:
    """136 / 2^10 and 26 / 2^15 are exact as well with mantissas that fill 16 bits."""
    found = pi_integers(136 / 2**10, 26 / 2**15, "auto")
    assert found is not None
    assert [gain.realised for gain in found] == [136 / 2**10, 26 / 2**15]
    assert min(gain.mantissa for gain in found) >= 2**14
    assert pi_integers(0.5, 0.01, None) is None


def test_velocity_form_with_two_products_loses_the_integral() -> None:
    """q0 + q1 is a small difference of two roundings: its error is that of one
    unit over a small number.
    """
    generator = np.random.default_rng(5)
    worst = 0.0
    for kp in np.exp(generator.uniform(-3.0, 3.0, 200)):
        ki = 1e-3 * kp
        q0, q1 = velocity_integers(float(kp), float(ki))
        error = abs(q0.realised + q1.realised - ki)
        assert error <= 2.0**-q0.shift * (1.0 + 1e-9)
        worst = max(worst, error / ki)
    assert 0.01 < worst < 0.1  # per cents, where each gain alone is exact to 3e-5


def fitted(width: int, loop: CurrentLoopSettings) -> FixedControlFit:
    design = make_design(SURFACE)
    control: ControlSettings = replace(design.control, current_loop=loop, t_s=1e-4)
    design = replace(design, control=control)
    gains = solve_gains(design)
    return fit_control(design, (gains.i_d, gains.i_q, None), None, width)


def test_margins_are_those_of_the_rounded_gains() -> None:
    """Coarse formats move the phase margin.

    It equals that of the loop with the rounded gains, simulated in reals.
    """
    fine = fitted(16, CurrentLoopSettings(q_formats="auto"))
    coarse = fitted(16, CurrentLoopSettings(q_formats=(4, 12)))
    loop = coarse.loops["i_q"]
    assert abs(loop.kp.error) > 0.005
    assert loop.found.phase_margin != pytest.approx(loop.exact.phase_margin, abs=1e-3)
    assert fine.loops["i_q"].found.phase_margin == pytest.approx(loop.exact.phase_margin, abs=1e-3)
    ratio = loop.kp.realised / loop.kp.value
    assert loop.found.kp == pytest.approx(loop.exact.kp * ratio, rel=1e-12)
    response = current_step_response(SURFACE.r_s, SURFACE.l_q, loop.found, 0.05)
    poles = np.abs(loop.found.poles)
    assert poles[0] < 1.0
    assert (
        abs(response.reference[-1] - 1.0) < 10.0 * poles[0] ** (response.reference.size - 1) + 1e-9
    )


def test_a_loop_that_rounding_spoils_is_refused() -> None:
    design = make_design(SURFACE)
    gains = solve_gains(design).i_q
    kp, ki_ts = real_pi(design, gains)
    with pytest.raises(
        NoSolutionError, match=r"control.current_loop: with kp .* the i_q loop is unstable"
    ):
        quantised_loop(design, gains, (FixedGain(400, 0, kp), given(ki_ts, 15)))


@pytest.mark.parametrize("width", [16, 32])
def test_wrong_sizes_of_bases_are_named(width: int) -> None:
    design = make_design(IPM)
    gains = solve_gains(design)
    loops = (gains.i_d, gains.i_q, gains.speed)
    small = replace(design.control.bases, current=200.0)
    with pytest.raises(
        ValueError, match=r"control.per_unit.current: 200 A is full scale.*write current: 354 A"
    ):
        fit_control(
            replace(design, control=replace(design.control, bases=small)), loops, None, width
        )
    slow = replace(design.control.bases, speed=500.0)
    faster = replace(design, machine=replace(IPM, omega_m_max=900.0))
    with pytest.raises(
        ValueError, match=r"control.per_unit.speed: .* rpm is full scale in fixed point"
    ):
        fit_control(
            replace(faster, control=replace(design.control, bases=slow)), loops, None, width
        )
    low = replace(design.control.bases, voltage=5.0, speed=1000.0)
    with pytest.raises(ValueError, match=r"control.per_unit.voltage: 5 V is too small a base"):
        fit_control(replace(design, control=replace(design.control, bases=low)), loops, None, width)


@pytest.mark.parametrize(("voltage", "held"), [(1.001, True), (0.999, False)])
def test_the_dc_link_and_its_headroom_fit_into_64_bases(voltage: float, held: bool) -> None:
    design = make_design(IPM)
    border = design.inverter.v_dc * 1.15 / 64.0
    bases = replace(design.control.bases, voltage=voltage * border, speed=1000.0)
    near = replace(design, control=replace(design.control, bases=bases))
    if held:
        _require_bases(near)
    else:
        with pytest.raises(InputError, match=r"control.per_unit.voltage: .* too small a base"):
            _require_bases(near)


def test_full_scale_of_the_speed_holds_field_weakening_too() -> None:
    """Its references would stand still from full scale on, unsaid."""
    design = replace(make_design(IPM), machine=replace(IPM, omega_m_max=400.0))
    bases = replace(design.control.bases, speed=500.0, current=2.0 * IPM.i_max)
    design = replace(design, control=replace(design.control, bases=bases))
    require_scales(replace(design, weakening=WeakeningSettings(omega_m=500.0)))
    with pytest.raises(InputError, match=r"the largest speed is 5729.6 rpm; write speed: 7162 rpm"):
        require_scales(replace(design, weakening=WeakeningSettings(omega_m=600.0)))


@pytest.mark.parametrize(
    "gains", [(363.0, 1.22e-5, 255.7), (0.38, 903.4, 347.1), (48.4, 3.0e-3, 663.2)]
)
def test_gains_that_no_format_holds_are_named_together(gains: tuple[float, float, float]) -> None:
    with pytest.raises(NoSolutionError, match="no format of 16 bits together") as told:
        _automatic("i_d", gains, 16, "parallel", 0)
    assert all(f"{gain:.4g}" in str(told.value) for gain in gains)
