"""SimpleFOC's motor of the e-scooter, run: it settles, with the library's default filter on the
currents it does not settle as fast.
"""

from __future__ import annotations

import pytest
from firmware_asked import scooter

from dqforge.optimizer.firmware.targets.simplefoc import configuration
from dqforge.reports.firmware.simplefoc import TARGET
from dqforge.reports.firmware.target import settles


@pytest.mark.slow
def test_current_torque_and_speed_settle() -> None:
    asked, method = scooter(), TARGET.method
    held = method.configure(asked)
    found = settles(method.profile(held), asked.design, held.drive)
    assert found.settles, found.failures
    assert len(found.tried) == 7
    own = {**held.own, "LPF_current_q.Tf": 0.005, "LPF_current_d.Tf": 0.005}
    slow = settles(method.profile(configuration("slow", own)), asked.design, held.drive)
    first, again = found.tried[0].answer, slow.tried[0].answer
    assert first.settling < 1e-3
    assert again.outcome != "settles" or again.settling > 10.0 * first.settling
