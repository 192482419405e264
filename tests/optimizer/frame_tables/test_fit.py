"""Frame tables against rotating coordinates made numerically, and what no table can follow."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.frame_transforms import (
    resampled,
    spectral_derivative,
    transform,
)
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, grid
from dqforge.optimizer.curves.single_precision import CONTRACTED
from dqforge.optimizer.frame_tables import (
    COLUMNS,
    Frames,
    decoupling,
    errors_of,
    exact_frames,
    fit_frames,
    solve_frame_tables,
    table_of,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT


def machine(orders: list[float], shares: list[float], pole_pairs: int = 2) -> PhaseMachine:
    return PhaseMachine.from_harmonics(
        orders,
        [0.2233 * share for share in shares],
        [0.0, *[0.3] * (len(orders) - 1)],
        pole_pairs=pole_pairs,
        r_s=1.0,
        l_s=7e-3,
        m_s=-1e-3,
        i_max=6.0,
    )


ODD = machine([1, 3, 5, 7], [1.0, 0.12, 0.03, 0.01])
EVEN = machine([1, 2, 3], [1.0, 0.05, 0.12])
PAIRS = machine([1, 3, 0.8, 1.2], [1.0, 0.12, 0.05, 0.02], pole_pairs=5)


def unequal() -> PhaseMachine:
    return replace(ODD, flux=ODD.flux * np.array([[1.0], [0.5], [1.0]]))


def numerical(one: PhaseMachine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inductive voltage and back-EMF per electrical speed in dqy, divided by a_y, of currents
    constant there: from the matrices alone, differentiated by their spectrum.
    """
    exact = exact_frames(one)
    theta = grid(exact.shape.shape[1], one.turns)
    matrix = transform("dqy", theta, exact.shape)
    factor = exact.columns[1]
    phases = factor * np.einsum("jkm,k->mj", matrix, current)
    linked = one.inductances @ spectral_derivative(phases, one.turns)
    volts = np.einsum("jkm,mj->kj", matrix, linked) / factor
    emf = np.einsum("jkm,mj->kj", matrix, exact.scale * exact.shape) / factor
    return volts, emf


@pytest.mark.thinned
@pytest.mark.parametrize("one", [ODD, EVEN, PAIRS, unequal()], ids=["odd", "even", "pairs", "half"])
def test_coupling_is_what_constant_currents_of_dqy_induce(one: PhaseMachine) -> None:
    """With three independent currents, against the turning matrices of the phases."""
    at = dict(zip(COLUMNS, exact_frames(one).columns, strict=True))
    for column, current in zip("dq0", np.eye(3), strict=True):
        volts, emf = numerical(one, current)
        for row, axis in enumerate("dq0"):
            np.testing.assert_allclose(at[f"c_{axis}{column}"], volts[row], atol=1e-11)
        np.testing.assert_allclose(emf[[0, 2]], 0.0, atol=1e-12)
        np.testing.assert_allclose(at["emf"], emf[1], rtol=1e-11)


@pytest.mark.parametrize("one", [ODD, EVEN, PAIRS, unequal()], ids=["odd", "even", "pairs", "half"])
def test_rates_are_the_slopes_of_what_stands_beside_them(one: PhaseMachine) -> None:
    at = dict(zip(COLUMNS, exact_frames(one).columns, strict=True))

    def slope(values: FloatArray) -> FloatArray:
        return spectral_derivative(values, one.turns)

    np.testing.assert_allclose(at["turn_x"], 1.0 + slope(at["theta_x"]), atol=1e-8)
    np.testing.assert_allclose(at["rate_y"], slope(at["theta_y"]), atol=1e-8)
    np.testing.assert_allclose(at["growth_x"], slope(at["a_x"]) / at["a_x"], atol=1e-8)
    np.testing.assert_allclose(at["growth_y"], slope(at["a_y"]) / at["a_y"], atol=1e-8)


def test_errors_fall_with_the_square_of_the_step() -> None:
    """64, 128 and 256 intervals for the machine of paper 002: 0.13, 0.033 and 0.010 % in the
    published judgement of such tables, quantised ones included; in float32 slightly less.
    """
    design = catalogue.load("paper002-phase-waveforms")
    assert isinstance(design.phase_machine, PhaseMachine)
    exact = exact_frames(design.phase_machine)
    found = [errors_of(exact, table_of(exact, size, 1), 1) for size in (64, 128, 256)]
    assert [100.0 * entry.torque for entry in found] == pytest.approx(
        [0.126, 0.032, 0.008], rel=0.05
    )
    assert [entry.coupling for entry in found] == pytest.approx([9.3e-3, 2.3e-3, 5.9e-4], rel=0.05)


@pytest.mark.thinned
@pytest.mark.parametrize("one", [ODD, EVEN, PAIRS], ids=["odd", "even", "pairs"])
def test_a_third_of_the_turn_says_all_of_equal_phases(one: PhaseMachine) -> None:
    exact = exact_frames(one)
    third, whole = (table_of(exact, 96, parts) for parts in (3, 1))
    assert 3 * third.size == whole.size == 96 * one.turns
    turn = np.random.default_rng(1).uniform(0.0, 1.0, 2000).astype(np.float32)
    found, wanted = third.values(turn), whole.values(turn)
    scale = np.max(np.abs(wanted), axis=1, keepdims=True)
    assert np.max(np.abs(found - wanted) / scale) < 2e-5
    assert errors_of(exact, third, one.turns).torque < 2e-3
    assert fit_frames(one, 5e-3).chosen.table.parts == 3
    assert fit_frames(unequal(), 5e-3).chosen.table.parts == 1


def test_the_smallest_table_that_holds_is_taken() -> None:
    found = fit_frames(ODD, 1e-4)
    assert found.chosen.errors.torque <= 1e-4
    assert all(entry.errors.torque > 1e-4 for entry in found.coarser)
    sizes = [entry.table.size for entry in (*found.coarser, found.chosen)]
    assert sizes == [16 * 2**k for k in range(len(sizes))]
    assert found.chosen.table.flash == 4 * 18 * (found.chosen.table.size + 1)
    with pytest.raises(NoSolutionError, match="with 1536 intervals the frame tables") as refused:
        fit_frames(ODD, 1e-9)
    percent = re.search(r"deviate by (\S+) %", str(refused.value))
    assert percent is not None
    # Four times less error with each doubling, until numbers of 32 bits end it.
    assert 1e-9 < float(percent[1]) / 100.0 < found.chosen.errors.torque


def test_turns_beyond_the_end_count_as_none() -> None:
    table = fit_frames(ODD, 5e-3).chosen.table
    special = np.array([1.0, -0.25, np.nan, np.inf, -0.0], dtype=np.float32)
    np.testing.assert_array_equal(
        table.values(special), np.tile(table.entries[0][:, np.newaxis], 5)
    )
    inside = np.array([0.25, 0.9], dtype=np.float32)
    np.testing.assert_allclose(
        table.values(inside, CONTRACTED), table.values(inside), rtol=1e-5, atol=1e-8
    )


@pytest.mark.parametrize(
    ("one", "message"),
    [
        (machine([1, 5], [1.0, 0.97]), r"as short as 0.0\d* of its largest phase value at \d+ deg"),
        (machine([1, 5], [1.0, 2.5]), "does not turn once in an electrical period"),
    ],
)
def test_shapes_without_a_steady_direction_are_refused(one: PhaseMachine, message: str) -> None:
    with pytest.raises(InputError, match=rf"export.frame_tables: .*{message}"):
        fit_frames(one, 5e-3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("paper000-ipmsm-100kw", "with a sinusoidal back-EMF dqx and dqy are dq"),
        ("salient-phase-waveforms", "hold for machines without saliency"),
    ],
)
def test_machines_without_such_frames_are_refused_with_their_place(name: str, message: str) -> None:
    """While reading, and of a design that a program changed."""
    plain = catalogue.read_text(name)
    text = plain.replace(b"\nexport:", b"\nexport:\n  frame_tables: true")
    refused = rf"drive.yaml:\d+:\d+: export.frame_tables: .*{message}"
    with pytest.raises(InputError, match=refused):
        load_text(text, "drive.yaml")
    design = load_text(plain, "drive.yaml")
    with pytest.raises(InputError, match=refused):
        solve_frame_tables(replace(design, export=replace(design.export, frame_tables=True)))


def test_a_design_that_asks_for_none_has_none() -> None:
    assert solve_frame_tables(catalogue.load("paper002-phase-waveforms")) is None


def test_interpolation_between_the_angles_is_that_of_the_spectrum() -> None:
    wave = np.cos(5.0 * grid(24))
    np.testing.assert_allclose(resampled(wave, 96), np.cos(5.0 * grid(96)), atol=1e-14)


def test_decoupling_is_a_matrix_on_the_currents_and_the_emf_on_the_q_axis() -> None:
    generator = np.random.default_rng(4)
    frames, currents = generator.normal(size=len(COLUMNS)), generator.normal(size=3)
    matrix = frames[-9:].reshape(3, 3)
    found = decoupling(EXACT, Frames(*frames), np.asarray(70.0), *currents)
    emf = np.array([0.0, frames[COLUMNS.index("emf")], 0.0])
    np.testing.assert_allclose(found, 70.0 * (matrix @ currents + emf), rtol=1e-12)
