"""Integers of ST's Workbench reproduced from the inputs in public projects, to one count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.st_scales import (
    Scales,
    current_gains,
    current_integers,
    fine_gain,
    shift,
    speed_gains,
    speed_integers,
    vendor_gain,
    workbench_gains,
)


@dataclass(frozen=True)
class Project:
    """Inputs as a project's headers print them, and its integers with their dividers."""

    name: str
    r_s: float
    inductance: float
    rate: float
    v_dc: float
    shunt: float
    gain: float
    kp: tuple[int, int]
    ki: tuple[int, int]

    @property
    def scales(self) -> Scales:
        full = 1.65 / (self.shunt * self.gain)
        return Scales(full, self.v_dc / 3**0.5, self.rate)

    @property
    def bandwidth(self) -> float:
        """rad/s by Workbench's rule, from kp."""
        volts = 0.5 * self.v_dc / self.scales.current
        return self.kp[0] / self.kp[1] * volts / self.inductance


# The last four are no part of the published collection that the rule was found with.
PROJECTS = (
    Project("hub motor", 0.12, 0.00068, 16e3, 36, 0.002, 20, (2394, 1024), (422, 16384)),
    Project("42JSF330", 1.86, 0.000518, 30e3, 24, 0.33, 1.53, (3467, 4096), (1660, 16384)),
    Project("car", 0.1, 1e-5, 16e3, 11, 0.01, 7.33, (3919, 16384), (2449, 16384)),
    Project("g431", 0.35, 0.0006, 20e3, 24, 0.003, 9.14, (2312, 128), (2158, 4096)),
    Project("BL42S", 2.0, 0.00051, 16e3, 24, 0.33, 1.53, (3418, 4096), (3351, 16384)),
    Project("control", 0.27, 0.00074, 20e3, 36, 0.01, 5.18, (2681, 2048), (391, 16384)),
    Project("wireless", 0.18, 0.00015, 16e3, 24, 0.003, 4.57, (2312, 256), (2774, 4096)),
    Project("demo", 0.14, 0.000021, 20e3, 14, 0.003, 9.14, (2158, 2048), (2877, 8192)),
    Project("servo", 0.1, 0.00002, 16e3, 12, 0.003, 9.14, (2399, 2048), (2999, 8192)),
    Project("robot", 0.31, 0.00011, 8e3, 24, 0.015, 2, (3304, 8192), (2328, 16384)),
)


@pytest.mark.parametrize("project", PROJECTS, ids=lambda project: project.name)
def test_one_bandwidth_gives_all_integers_and_dividers(project: Project) -> None:
    kp, ki = workbench_gains(
        project.r_s, project.inductance, project.v_dc, project.scales, project.bandwidth
    )
    assert (kp.divider, ki.divider) == (project.kp[1], project.ki[1])
    assert abs(kp.gain - project.kp[0]) <= 1
    assert abs(ki.gain - project.ki[0]) <= 1


def test_its_own_bandwidth_is_6000_within_the_printed_digits_of_its_inputs() -> None:
    """The volts are cut to whole ones, the gain is rounded to two places."""
    hidden = {"42JSF330": (24.0, 1.53), "g431": (24.0, 9.1356), "BL42S": (24.0, 1.528)}
    hidden |= {"wireless": (24.0, 4.5678), "demo": (14.4, 9.1356)}
    hidden |= {"servo": (12.334, 9.1356), "car": (11.288, 7.33304)}
    for project in PROJECTS:
        if project.name not in hidden:
            continue
        v_dc, gain = hidden[project.name]
        assert int(v_dc) == project.v_dc
        assert round(gain, 2) == project.gain
        scale = Scales(1.65 / (project.shunt * gain), v_dc / 3**0.5, project.rate)
        kp, ki = workbench_gains(project.r_s, project.inductance, v_dc, scale)
        assert abs(kp.gain - project.kp[0]) <= 1, project.name
        assert abs(ki.gain - project.ki[0]) <= 1, project.name


def test_what_runs_is_faster_than_what_workbench_shows() -> None:
    project = PROJECTS[3]
    own = {
        "PID_TORQUE_KP_DEFAULT": 2312,
        "PID_TORQUE_KI_DEFAULT": 2158,
        "TF_KPDIV": 128,
        "TF_KIDIV": 4096,
    }
    gains = current_gains(own, "TORQUE", project.scales)
    assert gains is not None
    # 12 V become 24 V/sqrt(3) of full scale
    assert gains.kp == pytest.approx(3.601991 * 2.0 / 3**0.5, rel=1e-6)
    assert gains.ki == pytest.approx(2101.2912 * 2.0 / 3**0.5, rel=1e-6)
    assert gains.kp / project.inductance == pytest.approx(6003.3 * 1.1547, rel=1e-4)


def test_gains_come_back_from_their_integers() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        scale = Scales(*(10.0 ** rng.uniform((0.3, 0.5, 3.6), (2.7, 2.7, 4.7))))
        kp = 10.0 ** rng.uniform(-2, 2) / scale.proportional
        ki = 10.0 ** rng.uniform(-2.5, 1) / scale.integral
        d, q = PiGains(kp * rng.uniform(0.3, 1.0), ki), PiGains(kp, ki * rng.uniform(0.3, 1.0))
        own = current_integers(d, q, scale)
        for name, wanted in (("FLUX", d), ("TORQUE", q)):
            found = current_gains(own, name, scale)
            assert found is not None
            kp_counts = (found.kp - wanted.kp) * scale.proportional * own["TF_KPDIV"]
            ki_counts = (found.ki - wanted.ki) * scale.integral * own["TF_KIDIV"]
            assert max(abs(kp_counts), abs(ki_counts)) <= 0.5 + 1e-9
            assert max(own.values()) <= 32768


def test_speed_gains_count_tenths_of_a_hertz() -> None:
    # 2 A per 0.1 Hz with 32.768 A of full scale: 2000 counts per count, one over the divider 1
    gains = PiGains(2.0 / (0.2 * np.pi), 40.0 / (0.2 * np.pi))
    own = speed_integers(gains, 32.768, 1000.0)
    assert own["PID_SPEED_KP_DEFAULT"] / own["SP_KPDIV"] == 2000.0
    assert own["PID_SPEED_KI_DEFAULT"] / own["SP_KIDIV"] == 40.0
    back = speed_gains(own, 32.768, 1000.0)
    assert back is not None
    assert back.kp == pytest.approx(gains.kp, rel=1e-12)
    assert back.ki == pytest.approx(gains.ki, rel=1e-12)


def test_dividers() -> None:
    assert (vendor_gain(0.2392).gain, vendor_gain(0.2392).divider) == (3919, 16384)
    assert (vendor_gain(18.06).gain, vendor_gain(18.06).divider) == (2312, 128)
    assert fine_gain(10.3 / 32768).divider == 32768  # rounded by 3 % with twice the step
    assert fine_gain(0.0).gain == 0
    assert shift(65535.0) == 65536.0
    with pytest.raises(InputError, match="does not fit 16 bits"):
        vendor_gain(40000.0)
