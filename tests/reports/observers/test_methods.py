"""Matsui's models, the Kalman filter and the sliding-mode observer as methods of a design: emitted,
verified, read back, judged.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import on_observer, within_a_percent

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.observers.methods import ekf as ekf_method
from dqforge.optimizer.observers.methods.ekf import ekf, ekf_gains
from dqforge.optimizer.observers.methods.matsui_model import matsui, steady_error
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import steady_observer
from dqforge.reports.observers.position_header import emitted, observer_from, plain_observer
from dqforge.reports.run import export_design, verify_folder

NEW: tuple[ObserverMethodName, ...] = ("matsui-voltage", "matsui-current", "ekf", "smo")


@pytest.fixture(autouse=True)
def quick_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for the covariances is tested where it is written; here any will do."""
    monkeypatch.setattr(
        ekf_method,
        "_consistent",
        lambda m, t_s, top: ekf_gains(ekf(m, t_s, 1e-2, 1e5, 1e-5, top)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NEW)
def test_header_is_emitted_verified_and_read_back(name: ObserverMethodName, tmp_path: Path) -> None:
    settings = ObserverSettings(method=name)
    design = within_a_percent(on_observer(catalogue.load("paper001-pmsm-bench"), settings))
    output = export_design(design, verify=True)
    assert output.verification is not None
    header = output.files["bench001_observer.h"].decode("ascii")
    assert f"bench001_{METHODS[name].code}_step(" in header
    for file_name, content in output.files.items():
        (tmp_path / file_name).write_bytes(content)
    assert verify_folder(tmp_path).languages
    part = emitted(output.solution.gains.position)
    assert part is not None
    plain = plain_observer(part)
    assert plain_observer(observer_from(plain)) == plain
    gains = plain["gains"]
    owner, member = (gains, "lag_r") if name == "smo" else (gains["model"], "table")
    owner[member] = owner[member][:-1]
    with pytest.raises(InputError, match="not what dqforge writes"):
        observer_from(plain)


def test_judgement_and_steady_error_agree() -> None:
    """Two derivations of the steady state and its poles: by the firmware's step, and by the
    estimator as analysed.
    """
    machine = linearised(catalogue.load("paper001-pmsm-bench").machine)
    true = replace(machine, r_s=0.8 * machine.r_s, l_q=0.9 * machine.l_q)
    t_s, current, speed = 2e-4, (0.0, 2.0), 700.0
    for kind in ("matsui-voltage", "matsui-current"):
        method = METHODS[kind]
        tuning = method.usual(machine, t_s, 1700.0)
        gains = method.design(machine, tuning, t_s, 2041.2)
        found = steady_observer(
            method, gains, t_s, plants(true), np.array([complex(*current)]), np.array([speed])
        )
        own = matsui(
            machine,
            t_s,
            "voltage" if kind == "matsui-voltage" else "current",
            tuning.pll_bandwidth,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=2041.2,
        )
        expected, poles = steady_error(own, true, speed, current)
        assert found.theta_error[0] == pytest.approx(expected.theta, abs=1e-7)
        assert found.omega_error[0] == pytest.approx(expected.omega, abs=1e-5)
        assert abs(found.poles[0, 0]) == pytest.approx(abs(poles[0]), abs=1e-4)


def test_kalman_filter_settles_at_the_covariance_of_its_riccati_equation() -> None:
    """The angle's steady error and stability of the frozen filter, without any noise."""
    machine = linearised(catalogue.load("paper001-pmsm-bench").machine)
    method, t_s = METHODS["ekf"], 2e-4
    gains = method.design(machine, method.usual(machine, t_s, 1700.0), t_s, 2041.2)
    omega = np.array([100.0, 700.0, 1700.0])
    found = steady_observer(method, gains, t_s, plants(machine, count=3), np.full(3, 2.0j), omega)
    assert np.all(found.found)
    assert np.max(np.abs(found.theta_error)) < 1e-5
    assert np.all(np.abs(found.poles[:, 0]) < 1.0)


@pytest.mark.slow
def test_commands_take_the_sliding_mode_observer(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """By keys alone, on the bench of paper 001: range and margins are printed, the files written,
    in single precision and in integers.
    """
    keys = ("control.observer={method: smo}", "control.speed_loop={method: symmetrical-optimum}")
    options = [word for key in keys for word in ("--set", key)]

    def said(code: int, *arguments: str) -> str:
        with pytest.raises(SystemExit) as stop:
            cli.main([*arguments, *options])
        captured = capsys.readouterr()
        assert stop.value.code == code, captured.err
        return " ".join((captured.out + captured.err).split())

    drive = "paper001-pmsm-bench"
    assert "sliding-mode" not in said(0, "check", drive)
    tuned = said(0, "tune", drive)
    assert re.search(r"runs on the sliding-mode observer: with its lag, at the worst speed", tuned)
    margins = re.search(
        r"phase margin at 27.1, 67.8, 136, 271 Hz \(electrical\): ([\d., ]+)", tuned
    )
    assert margins is not None
    assert all(float(part) > 30.0 for part in margins[1].strip(", ").split(","))
    steady = re.search(r"at constant speed from ([\d.]+) to ([\d.]+) Hz \(electrical\)", tuned)
    assert steady is not None
    assert float(steady[1]) < 27.1
    assert float(steady[2]) > 271.0
    ran = said(0, "run", drive, "--no-verify", "-o", str(tmp_path))
    assert "deg phase margin with the observer's lag" in ran
    assert "bench001_smo_step(" in (tmp_path / "bench001_observer.h").read_text("ascii")
    options += ["--set", "export.control=q15"]
    said(0, "export", drive, "-o", str(tmp_path / "q15"))
    header = (tmp_path / "q15" / "bench001_observer_q15.h").read_text("ascii")
    assert "bench001_smo_step_q15(" in header
