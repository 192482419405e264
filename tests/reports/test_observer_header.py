"""Header of a position observer: compiled and equal to its model, read back, refused when changed; design-file keys."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.drive_motion import drive_motion
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.settings import ObserverSettings
from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.position_observers import METHODS, observe
from dqforge.optimizer.solution import solve_gains
from dqforge.reports.observer_header import emitted, observer_files, observer_from, plain_observer, speed_range_text
from dqforge.reports.observer_model import SINGLE, observer_inputs, observer_outputs
from dqforge.reports.observer_text import plain_position, position_parts
from dqforge.reports.result_json import to_text
from dqforge.reports.run import export_design
from dqforge.reports.verify import verify_folder

EVERY = pytest.mark.parametrize("name", list(METHODS))


def _design(name: str):  # type: ignore[no-untyped-def]
    design = make_design()
    observer = ObserverSettings(method=name)  # type: ignore[arg-type]
    return replace(design, control=replace(design.control, observer=observer))


@pytest.mark.parametrize(
    "name", ["flux", *(pytest.param(other, marks=pytest.mark.slow) for other in METHODS if other != "flux")]
)
def test_run_emits_a_verified_header_that_verify_takes_and_that_fails_when_changed(name: str, tmp_path: Path) -> None:
    output = export_design(_design(name), verify=True)
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    assert output.verification.vectors + output.verification.sweep > 35_000
    for file_name, content in output.files.items():
        (tmp_path / file_name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "drive_observer.h"
    text = header.read_text()
    assert f"drive_{METHODS[name].code}_step" in text
    header.write_text(text.replace("observer->omega_e + (", "observer->omega_e - ("))
    with pytest.raises(VerificationError, match="results differ"):
        verify_folder(tmp_path)
    loaded = json.loads((tmp_path / "result.json").read_text())
    loaded["observer_header"]["method"] = "other"
    (tmp_path / "result.json").write_text(json.dumps(loaded))
    with pytest.raises(InputError, match="observer_header is not what dqforge writes"):
        verify_folder(tmp_path)


@EVERY
def test_an_observer_reads_back_as_it_was_written(name: str) -> None:
    observer = emitted(solve_gains(_design(name)).position)
    assert observer is not None
    plain = json.loads(json.dumps(plain_observer(observer)))
    again = observer_from(plain)
    inputs = observer_inputs(observer.gains, 2000, 5)
    np.testing.assert_array_equal(
        observer_outputs(again.method, again.gains, inputs), observer_outputs(observer.method, observer.gains, inputs)
    )
    plain["gains"]["pll"]["l_1"] = None
    with pytest.raises(InputError, match="run the design again"):
        observer_from(plain)


@EVERY
def test_single_precision_costs_no_angle(name: str) -> None:
    """The firmware's numbers against double precision over a whole run; and sequences reach every branch."""
    machine = LinearMachine(pole_pairs=3, r_s=0.5, l_d=2e-3, l_q=3e-3, psi_pm=0.1, i_max=20.0)
    method = METHODS[name]
    gains = method.design(machine, method.usual(machine, 1e-4, 2000.0), 1e-4, 2400.0)
    motion = drive_motion(machine, 1e-4, np.full((3000, 2), [1200.0, -700.0]), np.array([-2 + 8j]))
    single = observe(method, gains, motion, maths=SINGLE)
    assert single.theta_e.dtype == np.float32
    assert np.max(np.abs(single.angle_error(motion)[-500:])) < 1e-3
    outputs = observer_outputs(method, gains, observer_inputs(gains, 20_000, 3))
    assert np.isfinite(outputs).all()
    assert np.max(np.abs(outputs[:, 1])) * 1e-4 > 0.9


@EVERY
def test_what_is_said_agrees_with_what_was_judged(name: str) -> None:
    observer = solve_gains(_design(name)).position
    assert observer is not None
    ((title, columns, rows, notes),) = position_parts(observer)
    assert "Position observer" in title
    assert all(len(row) == len(columns) for row in rows)
    assert float(rows[-1][0]) == pytest.approx(observer.omega_max / (2.0 * np.pi), rel=1e-3)
    at_top = int(np.flatnonzero(observer.judgement.omega == observer.omega_max)[0])
    assert float(rows[-1][3]) == pytest.approx(np.degrees(observer.judgement.bias["l_q"][at_top]), rel=0.01)
    assert speed_range_text(observer) in notes[1]
    plain = json.loads(to_text("tune", "test", {"position": plain_position(observer)}))["position"]
    assert plain["method"] == name
    assert len(plain["poles"]) == len(plain["omega_rad_per_s"])


def test_header_is_the_same_bytes_every_time() -> None:
    design = _design("flux")
    first, second = (observer_files(design, solve_gains(design).position) for _ in range(2))  # type: ignore[arg-type]
    assert first == second
