"""Header of the reduced-order speed observer: compiled and equal to its model,
close to double precision, refused.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.observers.reduced_order import estimate_speed, reduced_order_observer
from dqforge.optimizer.observers.reduced_order_step import ReducedOrderGains
from dqforge.reports.observers.float32_model import (
    observed_speeds,
    plain_speed_observer,
    speed_observer_from,
    speed_observer_inputs,
    speed_observer_outputs,
)
from dqforge.reports.run import export_design, verify_folder


def test_run_emits_a_verified_header_that_fails_when_changed(tmp_path: Path) -> None:
    output = export_design(make_design(), verify=False)
    for file_name, content in output.files.items():
        (tmp_path / file_name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "drive_speed_observer.h"
    text = header.read_text()
    assert "drive_reduced_order_step" in text
    header.write_text(text.replace("v_q - (observer", "v_q + (observer"))
    with pytest.raises(VerificationError, match="results of the speed observer differ"):
        verify_folder(tmp_path)
    header.write_text(text)
    loaded = json.loads((tmp_path / "result.json").read_text())
    loaded["speed_observer_header"]["gains"]["a"] = None
    (tmp_path / "result.json").write_text(json.dumps(loaded))
    with pytest.raises(InputError, match="speed_observer_header is not what dqforge writes"):
        verify_folder(tmp_path)


def test_the_sampled_observer_of_the_theory_in_single_precision() -> None:
    """A turning machine with i_d = 0: the same estimate as `estimate_speed` gets from the
    voltage free of rotation.
    """
    t_s, count = 1e-4, 400
    observer = reduced_order_observer(SURFACE, 500.0, t_s)
    generator = np.random.default_rng(1)
    u_q, i_q = generator.uniform(20.0, 30.0, count), generator.uniform(-5.0, 5.0, count)
    expected = estimate_speed(observer, u_q, i_q, 100.0)
    theta = np.cumsum(np.full(count, 300.0 * t_s))
    middle = (
        theta + 0.5 * t_s * SURFACE.pole_pairs * expected
    )  # where the observer believes it to be
    v, i = 1j * u_q * np.exp(1j * middle), 1j * i_q * np.exp(1j * theta)
    ended = np.concatenate([[0.0], v[:-1]])

    def single(x: object) -> np.ndarray:
        return np.asarray(x, dtype=np.float32)[None]

    first = (single(theta[0])[0:1].reshape(1), np.array([300.0], dtype=np.float32))
    found = observed_speeds(
        ReducedOrderGains.of(SURFACE, observer),
        (single(ended.real), single(ended.imag)),
        (single(i.real), single(i.imag)),
        single(np.angle(np.exp(1j * theta))),
        first,
    )
    np.testing.assert_allclose(found[0, :, 0], expected, atol=2e-3)
    assert float(np.ptp(expected)) > 1.0


def test_sequences_reach_everything_and_read_back() -> None:
    plain = plain_speed_observer(IPM, reduced_order_observer(IPM, 500.0, 1e-5))
    assert plain is not None
    gains = speed_observer_from(json.loads(json.dumps(plain)))
    inputs = speed_observer_inputs(gains, 5000, 3)
    outputs = speed_observer_outputs(gains, inputs)
    assert outputs.shape == (5000, 2)
    assert np.all(np.isfinite(outputs))
    assert np.max(np.abs(inputs[:, 7])) > math.pi  # angles to be wrapped
    assert np.ptp(outputs[:, 0]) > 100.0
    assert plain_speed_observer(IPM, None) is None
    with pytest.raises(InputError, match="run the design again"):
        speed_observer_from({"gains": 3})
