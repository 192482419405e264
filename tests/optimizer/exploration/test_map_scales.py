"""Factors of a flux map found between two machines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.optimizer.exploration.variation import SCALE_FIELDS, scale_between

_LOADED = load("baldor-pmsyrm-5k6").machine
assert isinstance(_LOADED, SaturatedMachine)
_NOMINAL = _LOADED


def _scaled(**factors: float) -> SaturatedMachine:
    columns = {name: np.array([value]) for name, value in factors.items()}
    return ScaledMachines.varied(_NOMINAL, 1, columns).machine(0)


@pytest.mark.parametrize("name", SCALE_FIELDS)
def test_a_factor_is_found_between_scaled_maps(name: str) -> None:
    others = dict.fromkeys(SCALE_FIELDS, 0.97)
    first, last = _scaled(**others), _scaled(**{**others, name: 1.03})
    assert scale_between(first, last, 1.03 / 0.97) == name
    assert scale_between(first, last, 1.03 / 0.98) is None


def test_what_is_no_factor_is_none() -> None:
    both = _scaled(magnet=1.02, current=1.02)
    assert scale_between(_NOMINAL, both, 1.02) is None
    wider = replace(_NOMINAL, flux_map=replace(_NOMINAL.flux_map, extrapolate=True))
    assert _NOMINAL.flux_map.extrapolate is False
    assert scale_between(_NOMINAL, wider, 1.0) is None
