"""The emitted estimation of resistance and flux: equal to its model, read back, and told what the
simulated drive is.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text, read_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.online_estimation import FLUX, RESISTANCE, solve_online_estimation
from dqforge.reports.observers.online_estimation import (
    estimation_inputs,
    estimation_outputs,
    estimation_tables,
    estimation_text,
    model_from,
    plain_model,
)
from dqforge.reports.run import export_design, verify_folder
from dqforge.reports.simulation.design_run import simulate_design

TEXT = read_text("paper001-pmsm-bench").decode("utf-8")
# Weak magnets, then warm windings: fast and idle, then slow and loaded.
RUN = """simulation:
  duration: 16 s
  shaft: {points: [{time: 0 s, speed: 4500 rpm}, {time: 8 s, speed: 300 rpm}]}
  torque: {points: [{time: 0 s, torque: 0.1 N m}, {time: 8 s, torque: 1.4 N m}]}
  drift: {begin: 1 s, end: 3 s, resistance: 30 %, magnet_flux: -8 %}
  current_sensor: {bits: 12, full_scale: 12.8 A, noise: 20 mA}

export:
"""


def bench(keys: str = "{time_constant: 1 s}", run: str = "") -> Design:
    text = TEXT.replace("  per_unit:\n", f"  online_estimation: {keys}\n  per_unit:\n", 1)
    if run:
        text = text[: text.index("simulation:\n")] + run + text.partition("export:\n")[2]
    return load_text(text.encode(), "bench.yaml")


@pytest.mark.thinned
def test_run_emits_a_verified_header_that_fails_when_changed(tmp_path: Path) -> None:
    for name, content in export_design(bench(), verify=False).files.items():
        (tmp_path / name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "bench001_online_estimation.h"
    text = header.read_text()
    changed = text.replace("error_q / omega_e", "-error_q / omega_e", 1)
    assert changed != text
    header.write_text(changed)
    with pytest.raises(VerificationError, match="results of the on-line estimation differ"):
        verify_folder(tmp_path)


@pytest.mark.parametrize(
    ("keys", "there", "not_there"),
    [
        ("{flux: false}", "->r_most", "->psi_most"),
        ("{resistance: false}", "->psi_most", "->r_most"),
    ],
)
def test_the_firmware_holds_what_the_design_asks_for(keys: str, there: str, not_there: str) -> None:
    found = solve_online_estimation(bench(keys))
    assert found is not None
    text = estimation_text(found.sought, found.gains, "x")
    step = text[text.index("x_online_estimation_step(") :]
    assert there in step
    assert not_there not in step
    assert "->dead" in step


def test_the_rows_reach_every_branch_and_both_ends() -> None:
    found = solve_online_estimation(bench())
    assert found is not None
    model = model_from(json.loads(json.dumps(plain_model(found))))
    inputs = estimation_inputs(model.gains, 20_000, 3)
    r_s, psi_pm, status = estimation_outputs(model, inputs).T
    assert set(status.tolist()) == {0.0, float(RESISTANCE), float(FLUX), 3.0}
    for values, least, most in (
        (r_s, found.gains.r_least, found.gains.r_most),
        (psi_pm, found.gains.psi_least, found.gains.psi_most),
    ):
        assert np.any(values == np.float32(least))
        assert np.any(values == np.float32(most))
    assert np.any(~np.isfinite(inputs))


def test_data_that_are_not_its_own_are_refused() -> None:
    found = solve_online_estimation(bench())
    assert found is not None
    plain = json.loads(json.dumps(plain_model(found)))
    for spoilt in (
        plain | {"flux": 1},
        plain | {"gains": None},
        plain | {"flux": False, "resistance": False},
        plain | {"gains": plain["gains"] | {"share": "x"}},
    ):
        with pytest.raises(InputError, match="online_estimation_header"):
            model_from(spoilt)


def test_the_table_says_what_is_seen_where() -> None:
    found = solve_online_estimation(bench())
    assert found is not None
    (table,) = estimation_tables(found)
    assert {row[3] for row in table.rows} == {"neither", "resistance", "flux"}
    assert any("2.83 A" in note for note in table.notes)


def test_the_simulated_drive_tells_its_winding_and_its_magnets() -> None:
    found = simulate_design(bench(run=RUN))
    record, seen = found.run.estimation, found.estimation
    assert record is not None
    assert seen is not None
    machine = found.design.machine
    assert record.r_s[0] == pytest.approx(machine.r_s)
    assert seen.r_s_plant == pytest.approx(1.3 * machine.r_s)
    assert seen.psi_pm_plant == pytest.approx(0.92 * machine.psi_pm)
    # What is left of a dead time that takes as much as the resistance does.
    assert seen.r_s == pytest.approx(seen.r_s_plant, rel=0.02)
    assert seen.psi_pm == pytest.approx(seen.psi_pm_plant, rel=0.02)
    assert seen.r_s_share == pytest.approx(0.5, abs=0.02)
    assert seen.psi_pm_share == pytest.approx(0.5, abs=0.02)
    # Nothing of the control moves with it.
    text = TEXT[: TEXT.index("simulation:\n")] + RUN + TEXT.partition("export:\n")[2]
    plain = simulate_design(load_text(text.encode(), "bench.yaml")).run
    assert np.array_equal(plain.i_q, found.run.i_q)
    assert plain.estimation is None
