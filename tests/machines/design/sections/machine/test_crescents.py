"""Data between MTPA and MTPV, as vendors publish them: a crescent, of which only the inside tells
whether they are a machine's, and whose torque is not exceeded beyond.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from flux_map_writers import mat, text
from operating_tables import VENDOR, operating_table

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import largest_torque_within
from dqforge.machines.errors import InputError

TABLE = operating_table(speeds=33, shares=15)
PAIRS, I_MAX = VENDOR.pole_pairs, VENDOR.i_max
LARGEST = largest_torque_within(VENDOR, I_MAX)


def points(digits: int = 17) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    moving = TABLE.speed > 0.0
    parts = {"id": TABLE.i_d, "iq": TABLE.i_q, "psi_d": TABLE.psi_d, "psi_q": TABLE.psi_q}
    parts |= {"T [Nm]": TABLE.torque}
    return {
        name: np.array([float(f"{x:.{digits}g}") for x in part[moving]])
        for name, part in parts.items()
    }


def design(folder: Path, keys: str = "", current: str = "148 A", digits: int = 17) -> Design:
    path = folder / "design.yaml"
    (folder / "map.csv").write_bytes(text(points(digits)))
    path.write_text(f"""dqforge: 1
name: Crescent
machine:
  model: flux-map
  pole_pairs: {PAIRS}
  resistance: 0.1 Ohm
  max_current: {current}
  flux_map: {{file: map.csv{keys}}}
inverter: {{v_dc: 600 V, switching_frequency: 20 kHz}}
control: {{gains: false}}
""")
    return load_design(path)


def torque_of(found: Design) -> float:
    assert isinstance(found.machine, SaturatedMachine)
    return largest_torque_within(found.machine, I_MAX)


def test_the_points_are_a_crescent() -> None:
    """They reach the largest current, half of it on d, and leave out half of the hull."""
    size = np.hypot(TABLE.i_d, TABLE.i_q)
    assert np.max(size) == pytest.approx(I_MAX)
    assert -80.0 < np.min(TABLE.i_d) < -60.0
    low = TABLE.i_q < 0.4 * I_MAX
    assert np.min(TABLE.i_d[low]) > -25.0


@pytest.mark.parametrize("keys", ["", ", fit: smooth", ", extrapolate: true"])
@pytest.mark.parametrize("digits", [17, 5])
def test_a_crescent_makes_the_torque_of_its_machine(keys: str, digits: int, tmp_path: Path) -> None:
    found = design(tmp_path, keys, digits=digits)
    assert torque_of(found) == pytest.approx(LARGEST, rel=3e-3)
    probe_d, probe_q = np.array([-8.0, -20.0, -40.0]), np.array([120.0, 125.0, 135.0])
    np.testing.assert_allclose(
        np.stack(found.machine.flux(probe_d, probe_q)),
        np.stack(VENDOR.flux(probe_d, probe_q)),
        atol=1e-4,
    )
    told = " ".join(found.assumptions)
    assert "fit: smooth" in told
    assert "the points leave gaps" in told
    if not keys:
        assert "of the plain spline differ by" in told


def test_a_current_limit_beyond_the_crescent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lies beyond the flux map, which ends at 148 A"):
        design(tmp_path, current="160 A")


@pytest.mark.parametrize("wild", [False, True])
def test_a_torque_far_beyond_that_of_the_points_is_refused(wild: bool, tmp_path: Path) -> None:
    """A flat grid that ends at a tenth of the current in i_q; and points of which a plain spline
    makes anything beyond.
    """
    i_d, i_q = (
        part.ravel()
        for part in np.meshgrid(
            np.linspace(-150.0, 60.0, 8), np.linspace(0.0, 12.0, 6), indexing="ij"
        )
    )
    psi_d, psi_q = VENDOR.flux(i_d, i_q)
    if wild:  # what a slip of one row at the end of the grid does to the tangents there
        psi_q = psi_q * np.where(i_q == 12.0, 1.2, 1.0)
    parts = dict(zip(("id", "iq", "psi_d", "psi_q"), (i_d, i_q, psi_d, psi_q), strict=True))
    (tmp_path / "far.csv").write_bytes(text(parts))
    path = tmp_path / "far.yaml"

    def loaded(current: str) -> Design:
        path.write_text(f"""dqforge: 1
name: Far
machine:
  model: flux-map
  pole_pairs: {PAIRS}
  resistance: 0.1 Ohm
  max_current: {current}
  flux_map: {{file: far.csv, extrapolate: true, fit: interpolate}}
inverter: {{v_dc: 600 V, switching_frequency: 20 kHz}}
""")
        return load_design(path)

    most = PAIRS * 1.5 * float(np.max(np.abs(psi_d * i_q - psi_q * i_d)))
    with pytest.raises(InputError, match="its own points reach") as caught:
        loaded("120 A")
    assert f"reach {most:.4g} N m" in str(caught.value)
    assert "leave extrapolate out" in str(caught.value)
    loaded("12 A")


def test_a_table_of_operating_points_runs_as_the_machine(tmp_path: Path) -> None:
    size = TABLE.speed.shape
    arrays = {
        "Id_Peak": TABLE.i_d,
        "Iq_Peak": TABLE.i_q,
        "Vd_Peak": TABLE.v_d,
        "Vq_Peak": TABLE.v_q,
        "Speed": TABLE.speed * 30.0 / math.pi,
        "Frequency": TABLE.speed * PAIRS / (2.0 * math.pi),
        "Electromagnetic_Torque": TABLE.torque,
        "Total_Loss": TABLE.copper + TABLE.iron,
        "Power_Factor": np.ones(size),
    }
    (tmp_path / "map.mat").write_bytes(mat(arrays))
    path = tmp_path / "design.yaml"

    def written(pairs: int, resistance: str, keys: str) -> Path:
        path.write_text(f"""dqforge: 1
name: Table
machine:
  model: flux-map
  pole_pairs: {pairs}
  resistance: {resistance}
  max_current: 148 A
  flux_map: {{file: map.mat{keys}}}
inverter: {{v_dc: 600 V, switching_frequency: 20 kHz}}
control: {{gains: false}}
""")
        return path

    found = load_design(written(PAIRS, "0.1 Ohm", ", resistance: 0.1 Ohm"))
    assert torque_of(found) == pytest.approx(LARGEST, rel=3e-3)
    told = " ".join(found.assumptions)
    assert "not used of the file: Power_Factor" in told
    assert "without the copper loss of R = 100 mOhm of the design there remain" in told
    assert "has less loss than the copper loss" not in told
    with pytest.raises(InputError, match="come without a resistance; write flux_map: resistance"):
        load_design(written(PAIRS, "0.1 Ohm", ""))
    with pytest.raises(InputError, match=r"make .*5 .*pole pairs, the design has 3"):
        load_design(written(3, "0.1 Ohm", ", resistance: 0.1 Ohm"))
    warm = load_design(written(PAIRS, "0.16 Ohm", ", resistance: 0.1 Ohm"))
    warned = next(said for said in warm.assumptions if "less loss than the copper loss" in said)
    worst = float(np.max(0.6 * TABLE.copper - TABLE.iron))
    assert f"by up to {worst / 1e3:.3g} kW" in warned
    assert torque_of(warm) == pytest.approx(LARGEST, rel=3e-3)
