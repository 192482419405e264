"""Overshoot by R times the reference, against the loop integrated in time."""

from __future__ import annotations

import pytest

from dqforge.optimizer.firmware.moteus_format import overshoot


def stepped(share: float, ratio: float) -> float:
    """Largest excess over a unit step of winding and controller, R = L = 1."""
    step, current, integral, most = 2e-4, 0.0, 0.0, 0.0
    for _ in range(60000):
        error = 1.0 - current
        voltage = ratio * error + integral + share
        integral += ratio * error * step
        current += (voltage - current) * step
        most = max(most, current - 1.0)
    return most


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 4.0])
def test_the_closed_form_is_that_of_the_loop(share: float, ratio: float) -> None:
    assert overshoot(share, ratio) == pytest.approx(stepped(share, ratio), abs=3e-4)


def test_without_it_nothing_overshoots() -> None:
    assert overshoot(0.0, 3.0) == 0.0
