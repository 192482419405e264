"""Which keys change numbers alone, found by designs at the corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.variation import StepCache, batch_keys, key_of, variation

_BASE = load("paper000-ipmsm-100kw")
assert isinstance(_BASE.machine, LinearMachine)
_MACHINE = _BASE.machine


def _make(corner: Mapping[str, float]) -> Design:
    """A design in which ``r`` is the line resistance, ``v`` the link and ``t`` a period."""
    machine, inverter, control = _MACHINE, _BASE.inverter, _BASE.control
    if corner.get("v", 1.0) > 1000.0:
        raise InputError("above what the device blocks")
    if "r" in corner:
        machine = replace(machine, r_s=0.5 * corner["r"])
    if "v" in corner:
        inverter = replace(inverter, v_dc=corner["v"])
    if "t" in corner:
        control = replace(control, t_s=corner["t"])
    if "shifted" in corner:
        machine = replace(machine, l_d=1e-6 + corner["shifted"])
    return replace(_BASE, machine=machine, inverter=inverter, control=control)


def test_keys_with_their_factors() -> None:
    found = variation(_make, {"r": (2e-3, 4e-3), "v": (400.0, 500.0)})
    assert found is not None
    columns = found.columns({"r": np.array([3e-3]), "v": np.array([450.0])})
    assert columns == {"machine.r_s": [1.5e-3], "inverter.v_dc": [450.0]}
    assert found.keys_of(lambda design: design.inverter.v_dc) == ("v",)


@pytest.mark.parametrize(
    "bounds",
    [
        {"t": (1e-5, 2e-5)},  # a period is no number of machine or inverter
        {"v": (500.0, 1100.0)},  # one corner is refused
        {"shifted": (1e-4, 2e-4)},  # not in proportion
    ],
)
def test_what_does_more_varies_design_by_design(bounds: dict[str, tuple[float, float]]) -> None:
    assert variation(_make, bounds) is None
    assert batch_keys(_make, {"r": (1e-3, 2e-3), **bounds}) == ("r",)


def test_equal_inputs_are_computed_once_and_refusals_again_and_again() -> None:
    cache: StepCache[None] = StepCache()
    calls: list[int] = []

    def compute() -> None:
        calls.append(1)
        raise InputError("no")

    for _ in range(2):
        with pytest.raises(InputError, match="no") as caught:
            cache.of(key_of((_BASE.machine, 1.0)), compute)
        caught.value.line = 3  # a place of its own
    assert len(calls) == 1
    assert key_of(_BASE.machine) == key_of(load("paper000-ipmsm-100kw").machine)
    assert key_of(_BASE.machine) != key_of(replace(_MACHINE, r_s=1.0))
