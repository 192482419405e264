"""The constants in which the observer of a position believes."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.observers.solve import observed_machine

FLUX = "control.observer={method: flux}"
START = "control.start_up={method: i-f}"
LOOPS = (
    "control.current_loop={method: magnitude-optimum}",
    "control.speed_loop={method: symmetrical-optimum, ratio: 10}",
    "export.control=float32",
)


def test_a_saturated_machine_that_starts_without_encoder_is_known_at_half_its_torque() -> None:
    design = catalogue.load("baldor-pmsyrm-5k6", [FLUX, START, *LOOPS])
    found, idle = observed_machine(design), linearised(design.machine)
    assert found.l_q < 0.8 * idle.l_q
    assert found.l_d < 0.7 * idle.l_d
    # chords and tangents of the very machine at the currents of half the torque
    points = design.machine.jet(np.linspace(-20.0, 20.0, 81)[:, None], np.linspace(0.5, 20.0, 79))
    chords = points.psi_q / np.linspace(0.5, 20.0, 79)
    assert np.min(chords) < found.l_q < np.max(chords)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("baldor-pmsyrm-5k6", (FLUX,)),  # with an encoder: as ever
        ("paper001-pmsm-bench", (FLUX, START, *LOOPS)),  # no saturation: nothing to choose
    ],
)
def test_others_are_known_without_current(name: str, settings: tuple[str, ...]) -> None:
    design = catalogue.load(name, list(settings))
    assert observed_machine(design) == linearised(design.machine)
