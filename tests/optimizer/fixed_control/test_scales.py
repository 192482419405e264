"""Bounds and scales of the control in integers, against angles, corners and limits tried here."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.optimizer.fixed_control import design as scales
from dqforge.optimizer.fixed_control.codes import rotation, sine_error
from dqforge.optimizer.steps.integer_arithmetic import Integers


@pytest.mark.parametrize("width", [16, 32])
def test_error_of_the_sine_is_that_of_angles_all_round(width: int) -> None:
    """At multiples of the golden section of a turn: as far off as is said, within 15 %, which is
    less than two codes.
    """
    angle = np.arange(60_000) * 0x9E3779B9 % 2**32 >> (32 - width)
    turn, one = rotation(Integers(), width, angle), 2.0 ** (width - 1)
    exact = one * np.exp(2j * np.pi * angle / 2.0**width)
    worst = np.max(np.abs([turn.x - exact.real, turn.y - exact.imag]))
    assert worst < (1.4 if width == 16 else 2.0)
    assert sine_error(width) == pytest.approx(worst, rel=0.15)


def test_base_of_the_voltage_may_be_64_times_below_the_link_with_its_headroom() -> None:
    """1.15 * 214 V / 64 = 3.845 V."""

    def asked(base: str) -> None:
        scales._require_bases(
            catalogue.load("paper001-pmsm-bench", [f"control.per_unit.voltage={base}"])
        )

    asked("3.86 V")
    with pytest.raises(InputError, match=r"3\.83 V is too small a base for a dc link of 214 V"):
        asked("3.83 V")


@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize(("kp", "ki_ts", "further"), [(0.7, 0.2, 5), (-3.0, 0.01, 0), (0.0, 1, 90)])
def test_excess_stays_within_its_reach(width: int, kp: float, ki_ts: float, further: int) -> None:
    """Largest excess over corners: an error of two codes' full scales, an integral and an output at
    either end; a hundredth is left for gains that are rounded.
    """
    ends = -(2 ** (width - 1)), 2 ** (width - 1) - 1
    worst = max(
        abs(kp * (wanted - found) + ki_ts * (wanted - found) + integral + more - limited)
        for wanted, found, integral, limited, more in itertools.product(
            ends, ends, ends, ends, (-further, further)
        )
    )
    found = scales.excess_reach(width, kp, ki_ts, further)
    same_way = (abs(kp) + abs(ki_ts)) / max(abs(kp + ki_ts), 1e-9)
    assert worst <= found * 1.0001
    assert found <= 1.02 * same_way * worst + 3


@pytest.mark.parametrize(("share", "halvings"), [(0.3, 0), (0.9999, 0), (1.0001, 1), (3.9999, 2)])
def test_the_link_is_halved_until_its_headroom_of_15_percent_fits(
    share: float, halvings: int
) -> None:
    design = SimpleNamespace(
        inverter=SimpleNamespace(v_dc=share * 100.0 / 1.15),
        control=SimpleNamespace(bases=SimpleNamespace(voltage=100.0)),
    )
    assert scales._dc_scale(design) == halvings  # type: ignore[arg-type]
