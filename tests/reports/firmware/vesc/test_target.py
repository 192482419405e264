"""VESC's configuration of the e-scooter, run: it settles, and on the default of the tracking loop
it does not.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from firmware_asked import scooter

from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.reports.firmware.target import settles
from dqforge.reports.firmware.vesc import TARGET


@pytest.mark.slow
def test_current_torque_and_speed_settle_but_not_on_the_default_tracking_loop() -> None:
    asked, method = scooter(), TARGET.method
    for pll, expected in ((None, True), (PiGains(2000.0, 30000.0), False)):
        held = method.configure(replace(asked, pll=pll))
        found = settles(method.profile(held), asked.design, held.drive)
        assert found.settles is expected, found.failures
        assert len(found.tried) == 7
        assert all(("limit cycle of the speed" in words) for words in found.failures)
