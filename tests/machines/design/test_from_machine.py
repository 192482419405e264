"""Designs of machines that were built in Python: the file that is written
says what the numbers said.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.from_machine import MAP_FILE, make_design
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine

# Digits that no short decimal has, so that one lost digit shows.
LINEAR = LinearMachine(
    pole_pairs=4,
    r_s=1.0 / 47.0,
    l_d=1.0 / 2900.0,
    l_q=1.0 / 1700.0,
    psi_pm=1.0 / 9.7,
    i_max=900.0 / 7.0,
    inertia=1.0 / 700.0,
    friction=1.0 / 30001.0,
    omega_m_max=2000.0 / 3.0,
)


def saturated(**further: Any) -> SaturatedMachine:
    i_d, i_q = np.linspace(-150.0, 20.0, 9) / 1.01, np.linspace(-150.0, 150.0, 13) / 1.01
    grid_d, grid_q = np.meshgrid(i_d, i_q, indexing="ij")
    flux_map = FluxMap(i_d, i_q, 0.1 + 3e-4 * grid_d, 0.1 * np.tanh(grid_q / 170.0), **further)
    return SaturatedMachine(pole_pairs=4, r_s=1.0 / 47.0, flux_map=flux_map, i_max=120.0)


def test_constants_are_kept_to_the_last_digit() -> None:
    design = make_design(
        LINEAR, v_dc=1000.0 / 3.0, f_sw=1e5 / 7.0, name='Bench: no. 1 # "x"', prefix="bench"
    )
    assert design.machine == LINEAR
    assert design.inverter.v_dc == 1000.0 / 3.0
    assert design.inverter.f_sw == 1e5 / 7.0
    assert design.name == 'Bench: no. 1 # "x"'
    assert not [
        remark
        for remark in design.assumptions
        if "is taken as" in remark and remark.startswith("machine")
    ]


def test_a_flux_map_is_kept_but_for_rounding() -> None:
    machine = saturated()
    found = make_design(machine, v_dc=300.0, f_sw=1e4).machine
    assert isinstance(found, SaturatedMachine)
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        np.testing.assert_allclose(
            getattr(found.flux_map, name), getattr(machine.flux_map, name), rtol=1e-15
        )
    assert not found.flux_map.extrapolate
    beyond = make_design(saturated(extrapolate=True), v_dc=300.0, f_sw=1e4).machine
    assert isinstance(beyond, SaturatedMachine)
    assert beyond.flux_map.extrapolate


def test_harmonics_are_kept() -> None:
    machine = PhaseMachine.from_harmonics(
        [1, 3, 5],
        [0.2, 0.03, 0.01],
        [0.0, 0.1, 2.0],
        pole_pairs=2,
        r_s=1.0,
        l_s=8e-3,
        m_s=-1e-3,
        i_max=6.0,
    )
    found = make_design(machine, v_dc=300.0, f_sw=1e4).phase_machine
    assert isinstance(found, PhaseMachine)
    np.testing.assert_allclose(found.flux, machine.flux, atol=1e-14)
    assert (found.l_s, found.m_s, found.i_max) == (8e-3, -1e-3, 6.0)


def test_the_file_that_was_written_gives_the_same_design(tmp_path: Path) -> None:
    design = make_design(saturated(), v_dc=300.0, f_sw=1e4, fit={"degree": np.int64(3)})
    assert design.given is not None
    (tmp_path / "design.yaml").write_bytes(design.given.text)
    for name, content in design.given.named:
        (tmp_path / name).write_bytes(content)
    again = load_design(tmp_path / "design.yaml")
    assert [name for name, _ in design.given.named] == [MAP_FILE]
    assert again.digest == design.digest
    assert again.fit == design.fit
    assert design.fit.degree == 3


def test_the_same_numbers_give_the_same_bytes() -> None:
    first, second = (make_design(saturated(), v_dc=300.0, f_sw=1e4) for _ in range(2))
    assert first.given == second.given
    assert make_design(saturated(), v_dc=301.0, f_sw=1e4).digest != first.digest


def test_sections_go_over_what_the_arguments_say() -> None:
    control = {
        "current_loop": {"method": "bandwidth", "bandwidth": 1500.0},
        "sampling_frequency": 5e3,
    }
    machine = {"rated": {"torque": 20.0}}
    design = make_design(
        LINEAR, v_dc=300.0, f_sw=1e4, control=control, inverter={"dead_time": 1e-6}, machine=machine
    )
    assert design.control.t_s == pytest.approx(2e-4)
    assert design.control.current_loop.bandwidth == 1500.0
    assert design.inverter.dead_time == 1e-6
    assert design.inverter.v_dc == 300.0
    assert design.machine == LINEAR


REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"v_dc": float("nan")}, "v_dc: expected a finite number in V, got nan"),
    ({"v_dc": "300 V"}, "v_dc: expected a number in V, got str"),
    ({"f_sw": None}, "f_sw: expected a number in Hz, got NoneType"),
    ({"fitt": {}}, "unknown key 'fitt'; did you mean 'fit'"),
    ({"fit": {"degree": 99}}, r"fit.degree: expected a number of at most 6"),
    ({"prefix": "9 lives"}, "prefix"),
    ({"machine": "ipm"}, "machine"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSALS)
def test_refusals_are_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        make_design(LINEAR, **{"v_dc": 300.0, "f_sw": 1e4, **changes})
    assert "\n" not in str(error.value)


def test_what_is_no_machine_is_refused() -> None:
    other: Any = {"pole_pairs": 3}
    with pytest.raises(
        InputError, match="expected a LinearMachine, SaturatedMachine or PhaseMachine, got dict"
    ):
        make_design(other, v_dc=300.0, f_sw=1e4)
    unequal = PhaseMachine(
        2, 1.0, 8e-3, -1e-3, np.outer([1.0, 0.5, 1.0], np.sin(np.arange(360) * np.pi / 180.0)), 6.0
    )
    with pytest.raises(InputError, match="the three phases differ"):
        make_design(unequal, v_dc=300.0, f_sw=1e4)
    beyond = SaturatedMachine(4, 0.02, saturated().flux_map, 500.0)
    with pytest.raises(InputError, match="lies beyond the flux map"):
        make_design(beyond, v_dc=300.0, f_sw=1e4)
