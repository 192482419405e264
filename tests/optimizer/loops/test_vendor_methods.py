"""Rules of vendors' tools against the numbers that those tools printed, and against the recursions
that their firmware runs.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.loops.pi_methods import current_pi, speed_pi, vendor_inductance

TURN = 2.0 * math.pi


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / "vendor_gains" / name).open(newline="") as file:
        return list(csv.DictReader(file))


def test_nxp_prints_the_current_gains_of_its_rule(shared_data: Path) -> None:
    """Six digits of 19 headers: K_I is ki Ts where the PI adds the error of the sample, ki Ts/2
    where it takes the mean of two: one physical controller.
    """
    published = rows(shared_data, "nxp_mcat_pairs.csv")
    for row in published:
        asked = CurrentLoopSettings(
            method="nxp-mcat",
            bandwidth=TURN * float(row["F0_current_Hz"]),
            damping=float(row["xi_current"]),
        )
        t_s, share = float(row["Ts_current_s"]), float(row["ki_disc_factor"])
        fixed = row["number_format"] != "float"
        scale = float(row["Imax_A"]) * math.sqrt(3.0) / float(row["Udcmax_V"]) if fixed else 1.0
        for axis, inductance in (("D", row["Ld_H"]), ("Q", row["Lq_H"])):
            kp, ki = current_pi(float(row["Rs_ohm"]), float(inductance), t_s, asked)
            assert kp * scale == pytest.approx(float(row[f"{axis}_KP"]), rel=1e-5)
            assert ki * t_s * share * scale == pytest.approx(float(row[f"{axis}_KI"]), rel=1e-5)
    assert {float(row["ki_disc_factor"]) for row in published} == {0.5, 1.0}


def test_nxp_prints_the_speed_gains_of_its_rule_since_2025(shared_data: Path) -> None:
    """SPEED_PI_PROP per electrical rad/s: kp over p times the torque constant, here Ke."""
    told = [
        row
        for row in rows(shared_data, "nxp_mcat_pairs.csv")
        if (row["number_format"], row["ki_disc_factor"]) == ("float", "0.5")
    ]
    assert len(told) == 2
    for row in told:
        asked = SpeedLoopSettings(
            method="nxp-mcat",
            bandwidth=TURN * float(row["F0_speed_Hz"]),
            damping=float(row["xi_speed"]),
        )
        kp, ki = speed_pi(float(row["J_kgm2"]), 1e-4, 1e-3, asked)  # friction does not enter
        per_ampere = float(row["pole_pairs"]) * float(row["Ke_vendor"])
        assert kp / per_ampere == pytest.approx(float(row["SPEED_KP"]), rel=3e-6)
        half = 0.5 * float(row["Ts_speed_s"])
        assert ki / per_ampere * half == pytest.approx(float(row["SPEED_KI"]), rel=3e-6)


def test_st_prints_the_gains_of_its_rule(shared_data: Path) -> None:
    for row in rows(shared_data, "st_mcsdk_pairs.csv"):
        inductance = float(row["Ls_H(=Lq)"])
        omega = float(row["Kp_V_per_A"]) / inductance
        asked = CurrentLoopSettings(method="st-mcsdk", bandwidth=omega)
        rule = vendor_inductance("st-mcsdk", (0.5 * inductance, inductance), 0)
        kp, ki = current_pi(float(row["Rs_ohm"]), rule, 1e-4, asked)
        assert kp == pytest.approx(float(row["Kp_V_per_A"]), rel=1e-12)
        assert ki == pytest.approx(float(row["Ki_V_per_As"]), rel=3e-3)  # a count of its integer


def test_vesc_detects_the_gains_of_its_rule(shared_data: Path) -> None:
    """tc is 1000 us; the pair of bbshd was edited by hand: its kp is none of this rule."""
    for row in rows(shared_data, "vesc_pairs.csv"):
        asked = CurrentLoopSettings(method="vesc", bandwidth=1000.0)
        kp, ki = current_pi(float(row["R_ohm"]), float(row["L_H"]), 5e-5, asked)
        assert ki == pytest.approx(float(row["ki"]), rel=1e-4)
        assert (kp == pytest.approx(float(row["kp"]), rel=2e-4)) is ("m600" in row["file"])


def test_one_inductance_is_taken_where_the_firmware_knows_one() -> None:
    both = (1e-4, 3e-4)
    assert [vendor_inductance("vesc", both, place) for place in (0, 1)] == pytest.approx(
        [2e-4, 2e-4]
    )
    assert [vendor_inductance("st-mcsdk", both, place) for place in (0, 1)] == [3e-4, 3e-4]
    for method in ("ti", "infineon", "moteus", "nxp-mcat", "bandwidth"):
        assert [vendor_inductance(method, both, place) for place in (0, 1)] == list(both)


def test_ti_has_the_gains_of_its_series_controllers() -> None:
    """setupControllers: Kp = L BWc, Ki = R/L T/4; of the speed Kp = BWc/(delta Kctrl),
    Ki = BWc T/delta^2, Kctrl = 3 p lambda/(2 J); each PI adds Ki times its proportional part.
    """
    r_s, inductance, inertia, pairs, flux = 0.05, 1e-4, 2e-3, 15, 6.1e-3
    omega, delta, t_s, t_speed = TURN * 400.0, 20.0, 5e-5, 1e-3
    kp, ki = current_pi(r_s, inductance, t_s, CurrentLoopSettings("ti", omega))
    assert kp == pytest.approx(inductance * omega)
    assert ki * t_s == pytest.approx(kp * 0.25 * r_s / inductance * t_s)
    asked = SpeedLoopSettings(method="ti", spread=delta)
    kp, ki = speed_pi(inertia, 1e-4, 1.0 / omega, asked)
    per_ampere, control = 1.5 * pairs * flux, 3.0 * pairs * flux / (2.0 * inertia)
    series = omega / (delta * control)
    assert kp / per_ampere == pytest.approx(series)
    assert ki * t_speed / per_ampere == pytest.approx(series * omega * t_speed / delta**2)


def test_infineon_has_the_gains_of_its_parameters() -> None:
    """Kp = (8/3)/(P^2 lam) J bw in A per electrical rad/s with P poles."""
    inertia, friction, poles, flux, omega = 2e-3, 3e-4, 30, 6.1e-3, 60.0
    kp, ki = speed_pi(inertia, friction, 1e-3, SpeedLoopSettings("infineon", bandwidth=omega))
    per_ampere = 0.75 * poles * flux
    electrical = 0.5 * poles
    share = (8.0 / 3.0) / (poles**2 * flux)
    assert kp / per_ampere / electrical == pytest.approx(share * inertia * omega)
    assert ki / per_ampere / electrical == pytest.approx(share * friction * omega)
    assert current_pi(0.05, 1e-4, 5e-5, CurrentLoopSettings("infineon", omega)) == pytest.approx(
        (1e-4 * omega, 0.05 * omega)
    )
    with pytest.raises(NoSolutionError, match=r"machine\.friction is zero"):
        speed_pi(inertia, 0.0, 1e-3, SpeedLoopSettings("infineon", bandwidth=omega))


def test_moteus_has_the_gains_of_its_bandwidth() -> None:
    """kp = 2 pi f L, ki = 2 pi f R of pid_dq_hz."""
    asked = CurrentLoopSettings("moteus", TURN * 100.0)
    assert current_pi(0.05, 1e-4, 1e-4, asked) == pytest.approx(
        (TURN * 100.0 * 1e-4, TURN * 100.0 * 0.05)
    )


# --- in a design ----------------------------------------------------------------------------------

DRIVE = """\
dqforge: 1
name: hub
machine:
  model: linear
  pole_pairs: 15
  resistance: 50 mOhm
  inductance_d: 80 uH
  inductance_q: 120 uH
  magnet_flux: 6.1 mWb
  max_current: 56 A
  inertia: 0.002 kg m^2
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control:
"""


def gains_of(control: str) -> GainSet:
    text = DRIVE + "".join(f"  {line}\n" for line in control.splitlines())
    return solve_gains(load_text(text.encode(), "hub.yaml"))


def test_vesc_has_one_pair_for_both_axes_and_each_is_judged_on_its_own() -> None:
    gains = gains_of("current_loop: {method: vesc, bandwidth: 1000 Hz}")
    assert gains.i_d.kp == gains.i_q.kp == pytest.approx(TURN * 1000.0 * 1e-4)
    assert gains.i_d.inductance == pytest.approx(80e-6)
    assert gains.i_d.crossover > 1.4 * gains.i_q.crossover
    assert gains.i_d.method == "vesc"


def test_ti_takes_the_bandwidth_of_the_current_loop_for_the_speed() -> None:
    gains = gains_of(
        "current_loop: {method: ti, bandwidth: 400 Hz}\nspeed_loop: {method: ti, spread: 20}"
    )
    assert gains.speed is not None
    omega = TURN * 400.0
    assert gains.speed.kp == pytest.approx(0.002 * omega / 20.0)
    assert gains.speed.ki == pytest.approx(0.002 * omega**2 / 20.0**3)


def test_a_rule_that_does_not_hold_is_refused_with_what_would() -> None:
    with pytest.raises(NoSolutionError, match=r"method 'vesc' holds up to control\.current_loop"):
        gains_of("current_loop: {method: vesc, bandwidth: 3000 Hz}")
    with pytest.raises(NoSolutionError, match=r"holds from control\.speed_loop\.spread = 2"):
        gains_of(
            "current_loop: {method: ti, bandwidth: 400 Hz}\nspeed_loop: {method: ti, spread: 1.8}"
        )
    with pytest.raises(NoSolutionError, match=r"kp is positive from control\.current_loop"):
        gains_of("current_loop: {method: nxp-mcat, bandwidth: 5 Hz}")


@pytest.mark.parametrize(
    ("control", "said"),
    [
        ("current_loop: {method: vesc}", "the method 'vesc' needs the key 'bandwidth'"),
        ("current_loop: {method: vescs}", "did you mean 'vesc'?"),
        ("speed_loop: {method: vesc, bandwidth: 9 Hz}", "expected one of bandwidth, damping"),
        ("speed_loop: {method: ti, bandwidth: 9 Hz}", "does not use 'bandwidth'"),
        ("speed_loop: {method: nxp-mcat}", "the method 'nxp-mcat' needs the key 'bandwidth'"),
    ],
)
def test_what_a_rule_needs_is_asked_for(control: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        gains_of(control)
    assert said in str(caught.value)
