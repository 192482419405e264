"""Random drives: their ranges, their rated point, and that a series stays what it is."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.from_machine import LINKS, random_drive, random_drives

DRIVES = random_drives(200)


def test_first_drives_of_a_series_are_the_series() -> None:
    assert random_drives(12) == DRIVES[:12]
    assert random_drive(7) == DRIVES[7]
    assert random_drive(7, seed=2) != DRIVES[7]


def test_every_drive_lies_within_the_ranges() -> None:
    for drive in DRIVES:
        machine, v_rated = drive.machine, 0.9 * drive.v_dc / math.sqrt(3.0)
        impedance = v_rated / machine.i_max
        assert drive.v_dc in LINKS
        assert 3.0 <= machine.i_max <= 80.0
        assert 2 <= machine.pole_pairs <= 7
        assert 60.0 <= drive.omega_rated / (2.0 * math.pi) <= 350.0
        assert 0.015 <= machine.r_s / impedance <= 0.12
        assert 0.12 <= drive.omega_rated * machine.l_d / impedance <= 0.5
        assert drive.saliency == 1.0 or 1.1 <= drive.saliency <= 2.5
        assert 0.05 <= drive.saturation <= 0.3
        assert 8e3 <= drive.f_s <= 20e3
        assert drive.dead_time == (0.5e-6 if drive.v_dc < 100.0 else 3e-6)


def test_rated_torque_reaches_rated_speed_in_the_drawn_time() -> None:
    times = [
        float(drive.machine.inertia or 0.0)
        * float(drive.machine.omega_m_max or 0.0)
        / drive.torque_rated
        for drive in DRIVES
    ]
    assert 0.03 <= min(times) < 0.04
    assert 0.4 < max(times) <= 0.5


def test_rated_voltage_carries_rated_speed_and_current() -> None:
    for drive in DRIVES:
        machine, omega = drive.machine, drive.omega_rated
        voltage = math.hypot(
            omega * machine.psi_pm + machine.r_s * machine.i_max,
            omega * machine.l_d * machine.i_max,
        )
        assert math.isclose(voltage, 0.9 * drive.v_dc / math.sqrt(3.0), rel_tol=1e-9)


def test_draws_are_spread() -> None:
    """Two fifths without saliency, every link about as often, angles all round."""
    round_rotors = np.mean([drive.saliency == 1.0 for drive in DRIVES])
    assert abs(round_rotors - 0.4) < 0.1
    for link in LINKS:
        assert abs(np.mean([drive.v_dc == link for drive in DRIVES]) - 0.25) < 0.1
    angles = np.array([drive.theta_e for drive in DRIVES])
    assert abs(np.mean(np.exp(1j * angles))) < 0.15
    currents = np.log([drive.machine.i_max for drive in DRIVES])
    assert abs(np.median(currents) - math.log(math.sqrt(3.0 * 80.0))) < 0.3
