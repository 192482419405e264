"""Sweeps of four real motors, against the fit that their own tool stored with them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bench_files import MOTEUS, moteus_bench

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.optimizer.identification.identify import Identification, identify
from dqforge.optimizer.identification.speed_sweep import Sweep, analyse_sweep, sweep_fault

SOUND = ("mj5208", "mad8318", "flipsky6374")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory, shared_data: Path) -> dict[str, Identification]:
    """What the sweep of each motor says."""
    folder = tmp_path_factory.mktemp("moteus")
    return {
        motor: identify(read_bench(moteus_bench(folder, shared_data, motor))) for motor in MOTEUS
    }


@pytest.mark.parametrize("motor", SOUND)
def test_the_fit_of_moteus_with_an_error(
    swept: dict[str, Identification], shared_data: Path, motor: str
) -> None:
    stored = json.loads((shared_data / f"bench/moteus_ld/ld_{motor}.json").read_text())["fit"]
    found = swept[motor]
    keys = {"magnet_flux": "lambda_m", "inductance_d": "B", "inductance_d_slope": "C"}
    for key, name in keys.items():
        parameter = found.of(key)
        assert parameter is not None
        assert parameter.value == pytest.approx(stored[name], rel=1e-9)
    flux = found.of("magnet_flux")
    assert flux is not None
    assert flux.status == "identified"
    assert 0.002 < flux.sigma / flux.value < 0.0065
    # The degree beyond the second gains nothing strongly.
    assert found.of("inductance_d_curve") is None
    assert not found.contradictions


def test_an_inductance_that_depends_on_the_offset_is_told(
    swept: dict[str, Identification],
) -> None:
    (told,) = (text for text in swept["mj5208"].remarks if "model of the offset" in text)
    assert "28.5 uH with one offset for each level, 67.4 uH with one for all" in told


def test_a_motor_that_contradicts_its_back_emf_identifies_nothing(
    swept: dict[str, Identification],
) -> None:
    found = swept["hoverboard"]
    (text,) = found.contradictions
    assert "differ by a factor of 1.58" in text
    assert {parameter.status for parameter in found.parameters} == {"not identified"}
    (left,) = found.analyses[0].residuals
    assert 0.07 < left.rms < 0.08
    slope = found.of("inductance_d_slope")
    assert slope is not None
    assert slope.low < 0.0 < slope.high


def test_no_interval_depends_on_the_unit() -> None:
    """Voltages in mV: every flux linkage, inductance and end of an interval is a thousandfold."""
    currents = np.repeat(np.linspace(0.0, -30.0, 6), 4)
    speeds = np.tile(np.linspace(200.0, 700.0, 4), 6)
    rng = np.random.default_rng(3)
    flux = 5e-3 + 40e-6 * currents + rng.normal(0.0, 2e-6, 6).repeat(4)
    voltage = speeds * flux + rng.normal(0.0, 1e-3, 24)
    volts, millivolts = (
        analyse_sweep(Sweep("run", currents, speeds, scale * voltage), None) for scale in (1.0, 1e3)
    )
    for key in ("magnet_flux", "inductance_d"):
        one, other = volts.of(key), millivolts.of(key)
        assert one is not None
        assert other is not None
        ends = (one.value, one.sigma, one.low, one.high)
        assert (other.value, other.sigma, other.low, other.high) == pytest.approx(
            [1e3 * end for end in ends], rel=1e-9
        )


def test_intervals_hold_the_truth_where_levels_differ() -> None:
    """Errors of a level that all its rows share, such as of the current: most of them."""
    currents = np.repeat(np.linspace(0.0, -30.0, 8), 6)
    speeds = np.tile(np.linspace(200.0, 700.0, 6), 8)
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        off = rng.normal(0.0, 2e-6, 8).repeat(6)
        flux = 5e-3 + 40e-6 * currents - 1e-7 * currents**2 + off
        voltage = speeds * flux + rng.normal(0.0, 1e-3, 48)
        one = analyse_sweep(Sweep("run", currents, speeds, voltage), None).of("magnet_flux")
        assert one is not None
        held += one.low <= 5e-3 <= one.high
    assert 0.90 <= held / 200 <= 0.995


@pytest.mark.parametrize(
    ("currents", "speeds", "words"),
    [
        ([0.0, 0.0, -5.0, -5.0], [1.0, 2.0, 1.0, 2.0], "2 levels of i_d"),
        ([0.0, 0.0, -5.0, -5.0, -9.0, -9.0], [1.0, 2.0, 1.0, 2.0, 2.0, 2.0], "has one speed"),
    ],
)
def test_what_says_nothing(currents: list[float], speeds: list[float], words: str) -> None:
    sweep = Sweep("run", np.array(currents), np.array(speeds), np.zeros(len(currents)))
    assert words in sweep_fault(sweep)
