"""Fit, gains, losses, waveforms and simulation asked for in Python: the numbers of the commands,
and their arrays.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dqforge
from dqforge import cli
from dqforge.reports.pages.templating import to_text

MACHINE = dqforge.LinearMachine(
    pole_pairs=3, r_s=2.35, l_d=1.61e-3, l_q=1.74e-3, psi_pm=0.06, i_max=6.4, inertia=2e-4
)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    with pytest.raises(SystemExit) as end:
        cli.main([*arguments, "--json"])
    assert end.value.code == 0
    return json.loads(capsys.readouterr().out)


def as_printed(plain: dict[str, Any]) -> Any:
    return json.loads(to_text("", "", {"found": plain}))["found"]


def without_envelope(said: dict[str, Any]) -> dict[str, Any]:
    return {
        key: value
        for key, value in said.items()
        if key not in {"dqforge", "format", "command", "design"}
    }


def test_the_certified_fit_is_that_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    said = printed(capsys, "fit", "paper001-pmsm-bench")
    proven = dqforge.certify(dqforge.fit(dqforge.load_design("paper001-pmsm-bench")))
    assert as_printed(proven.plain()) == without_envelope(said)
    assert proven.certificate is not None
    assert proven.errors.torque_relative <= proven.certificate.torque_relative


def test_the_fit_gives_the_currents_of_the_firmware() -> None:
    """The emitted polynomials hold the torque within what the fit says of itself."""
    machine = dqforge.LinearMachine(
        pole_pairs=4, r_s=0.02, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=300.0
    )
    found = dqforge.fit(
        dqforge.make_design(machine, v_dc=400.0, f_sw=1e4, fit={"form": "polynomial", "degree": 3})
    )
    torque = np.linspace(-found.torque_max, found.torque_max, 401)
    i_d, i_q = found.currents(torque.reshape(1, -1))
    assert i_d.dtype == np.float32
    assert i_d.shape == (1, 401)
    made = 1.5 * 4 * (0.1049 + (350e-6 - 592e-6) * i_d.astype(float)) * i_q.astype(float)
    assert found.errors.torque > 1e-3
    assert np.max(np.abs(made - torque)) <= found.errors.torque * (1.0 + 1e-6)


def test_gains_are_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    said = printed(capsys, "tune", "paper001-pmsm-bench")
    found = dqforge.tune(dqforge.load_design("paper001-pmsm-bench"))
    assert as_printed(found.plain()) == without_envelope(said)


def test_gains_of_a_machine_from_numbers() -> None:
    """Bandwidth and pole-zero cancellation: kp = omega_c L, ki = omega_c R."""
    control = {"current_loop": {"method": "bandwidth", "bandwidth": 2000.0}}
    gains = dqforge.tune(dqforge.make_design(MACHINE, v_dc=180.0, f_sw=10e3, control=control)).gains
    assert gains.i_q.ki / gains.i_q.kp == pytest.approx(2.35 / 1.74e-3, rel=1e-9)
    assert gains.i_d.kp / gains.i_q.kp == pytest.approx(1.61 / 1.74, rel=1e-9)


def test_losses_are_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    said = printed(capsys, "losses", "paper000-ipmsm-100kw")["losses"]
    design = dqforge.load_design("paper000-ipmsm-100kw")
    found = dqforge.losses(design)
    assert as_printed(found.plain()) == said
    assert design.losses is not None
    point = design.losses.points[0]
    again = dqforge.losses(design, point.torque, [point.omega_m])
    np.testing.assert_array_equal(again.total, found.total)
    assert again.best == found.best


def test_the_loss_map_is_that_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--map", "3x4", "--modulations", "svpwm,ddt-gdpwm", "--strategies", "mtpa")
    said = printed(
        capsys, "losses", "paper000-ipmsm-100kw", *arguments, "--frequencies", "20 kHz,40 kHz"
    )["loss_map"]
    found = dqforge.loss_map(
        dqforge.load_design("paper000-ipmsm-100kw"),
        3,
        4,
        modulations=["ddt-gdpwm", "svpwm"],
        strategies="mtpa",
        f_sw=[20e3, 40e3],
    )
    assert as_printed(found.plain()) == said
    assert found.total.shape == (4, 3, 4)
    least = np.nanargmin(found.total[:, 1, 1])
    assert found.best[1, 1] == least


LOSS_REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"torque": 10.0}, "give torque and omega_m together"),
    ({"modulations": ["svm"]}, "modulations: expected some of spwm"),
    ({"strategies": []}, "strategies: name at least one"),
    ({"f_sw": -1.0}, "f_sw: expected each frequency once"),
    ({"f_sw": [20e3, 50e3]}, "f_sw: expected one number in Hz, got 2; .*loss_map at several"),
    ({"margin": 1.0}, "margin: expected a share"),
    ({"margin": [0.1, 0.2]}, "margin: expected one number in 1, got 2"),
    ({"torque": [1.0, 2.0], "omega_m": [1.0, 2.0, 3.0]}, "have no common shape"),
]


@pytest.mark.parametrize(("given", "message"), LOSS_REFUSALS)
def test_refusals_of_losses(given: dict[str, Any], message: str) -> None:
    with pytest.raises(dqforge.InputError, match=message):
        dqforge.losses(dqforge.load_design("paper000-ipmsm-100kw"), **given)


def test_a_single_frequency_may_be_an_array() -> None:
    design = dqforge.load_design("paper000-ipmsm-100kw")
    given = {"strategies": "mtpa", "modulations": "svpwm"}
    slow, fast = (dqforge.losses(design, 130, 300, f_sw=f, **given).total for f in ([2e4], 5e4))  # type: ignore[arg-type]
    assert slow.shape == (1, 1, 1)
    assert slow < fast


def test_alternatives_that_a_phase_machine_does_not_have_are_refused() -> None:
    """Its rules take the place of strategies, the centring of four legs that of modulators."""
    design = dqforge.load_design("paper002-phase-waveforms")
    for ask in (dqforge.losses, dqforge.loss_map):
        with pytest.raises(dqforge.InputError, match="compared by the rules dq, dqx, dqy and limi"):
            ask(design, strategies=["mtpa"])
        with pytest.raises(dqforge.InputError, match="has one modulator, svpwm; omit modulations"):
            ask(design, modulations=["dpwm1"])


def test_a_design_without_points_says_what_to_give() -> None:
    with pytest.raises(dqforge.InputError, match="the design names no points; give torque in N m"):
        dqforge.losses(dqforge.make_design(MACHINE, v_dc=180.0, f_sw=10e3))


def test_waveforms_are_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--torque", "1 N m", "--speed", "70 rad/s", "--ripple", "5 %")
    said = printed(capsys, "dqy", "paper002-phase-waveforms", *arguments)["waveforms"]
    design = dqforge.load_design("paper002-phase-waveforms")
    found = dqforge.waveforms(design, torque=1.0, omega_m=70.0, ripple=0.05)
    assert as_printed(found.plain()) == said
    assert found.rules["dqy"].currents.shape == (3, found.theta_e.size)
    with pytest.raises(dqforge.InputError, match="ripple: expected a share"):
        dqforge.waveforms(design, ripple=1.5)
    with pytest.raises(dqforge.InputError, match="torque: expected one number in N m, got 2"):
        dqforge.waveforms(design, torque=[1.0, 2.0])  # type: ignore[arg-type]
    with pytest.raises(dqforge.InputError, match="open_phase: expected"):
        dqforge.waveforms(design, open_phase="d")


def capture_file(path: Path) -> Path:
    """50 Hz, 80 V with 18 % of third harmonic."""
    time = np.arange(3000) * 20e-6
    angles = [2.0 * np.pi * 50.0 * time - k * 2.0 * np.pi / 3.0 for k in range(3)]
    columns = np.column_stack(
        [time, *(80.0 * (np.sin(a) + 0.18 * np.sin(3.0 * a)) for a in angles)]
    )
    np.savetxt(path, columns, delimiter=",", header="time [s],a [V],b [V],c [V]", comments="")
    return path


def test_a_capture_is_that_of_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = capture_file(tmp_path / "capture.csv")
    said = printed(capsys, "bemf", str(file), "--pole-pairs", "2", "--harmonics", "7")["bemf"]
    found = dqforge.read_back_emf(file, pole_pairs=2, harmonics=7)
    assert as_printed(found.plain()) == said
    assert found.psi_pm == pytest.approx(80.0 / (2.0 * np.pi * 50.0), rel=1e-6)


def test_a_machine_of_a_capture_has_its_back_emf(tmp_path: Path) -> None:
    found = dqforge.read_back_emf(str(capture_file(tmp_path / "capture.csv")), pole_pairs=2)
    machine = found.machine(pole_pairs=2, r_s=1.2, l_s=8e-3, m_s=-1e-3, i_max=8.0)
    shape = np.sin(found.theta_e) + 0.18 * np.sin(3.0 * found.theta_e)
    expected = 80.0 / (2.0 * np.pi * 50.0) * shape
    # The d axis lies where the flux of phase a is largest, so that its back-EMF is - sin theta.
    np.testing.assert_allclose(machine.flux[0], -expected, atol=1e-6)
    design = dqforge.make_design(machine, v_dc=300.0, f_sw=10e3, inverter={"topology": "four-leg"})
    assert design.phase_machine is not None
    np.testing.assert_allclose(design.phase_machine.flux, machine.flux, atol=1e-12)


BEMF_REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"interval": 0.0}, "interval: expected a time above 0"),
    ({"interval": [1e-6, 2e-6]}, "interval: expected one number in s, got 2"),
    ({"omega_m": [1.0, 2.0]}, "omega_m: expected one number in rad/s, got 2"),
    ({"scale": (1.0, 2.0)}, "scale: expected three factors"),
    ({"pole_pairs": 0}, "pole_pairs: expected a whole number"),
    ({"harmonics": 500}, "harmonics: expected a whole number"),
]


@pytest.mark.parametrize(("given", "message"), BEMF_REFUSALS)
def test_refusals_of_captures(given: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(dqforge.InputError, match=message):
        dqforge.read_back_emf(capture_file(tmp_path / "capture.csv"), **given)


@pytest.mark.slow
def test_a_simulation_has_the_numbers_of_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    simulation = {"duration": 0.05, "speed": {"points": [{"time": 0.0, "speed": 50.0}]}}
    control = {"speed_loop": {"method": "symmetrical-optimum"}}
    design = dqforge.make_design(
        MACHINE, v_dc=180.0, f_sw=10e3, control=control, simulation=simulation
    )
    assert design.given is not None
    (tmp_path / "design.yaml").write_bytes(design.given.text)
    said = printed(capsys, "simulate", str(tmp_path / "design.yaml"), "-o", str(tmp_path / "out"))[
        "simulation"
    ]
    shares: list[float] = []
    found = dqforge.simulate(design, progress=shares.append)
    assert as_printed(found.plain()) == said
    assert found.t.shape == found.omega_m.shape == found.i_q.shape
    assert found.omega_m[-1] == pytest.approx(50.0, abs=1.0)
    assert 0.9 < shares[-1] <= 1.0
    with pytest.raises(dqforge.InputError, match="requests no simulation"):
        dqforge.simulate(dqforge.make_design(MACHINE, v_dc=180.0, f_sw=10e3))
