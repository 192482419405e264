"""References of machines whose halves differ: one for each sign of the torque, compiled,
verified and proven.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from noisy import grid_points, mapped_design
from saturated import ArctanMachine

from dqforge import cli
from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.errors import InputError
from dqforge.optimizer.current_reference.forms import SignedReference
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.current_reference.plain import from_plain, to_plain
from dqforge.reports.main_header import header_files
from dqforge.reports.run import read_folder, verify_folder
from dqforge.reports.verification.host import verify_files

TRUE = ArctanMachine()


def leaning(i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flux linkages of a machine whose halves differ by 3 % of psi_d, at any currents in A."""
    psi_d, psi_q = TRUE.flux(i_d, i_q)
    return psi_d * (1.0 + 0.015 * np.tanh(i_q / 20.0)), psi_q


@pytest.fixture(scope="module")
def design_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    i_d, i_q, *_ = grid_points(TRUE, (25, 37))
    points = (i_d, i_q, *leaning(i_d, i_q))
    fit = "fit: {form: polynomial, degree: 3, segments: 2}\n"
    return mapped_design(
        tmp_path_factory.mktemp("leaning"), TRUE, points, keys=", symmetry: keep", control=fit
    )


@pytest.fixture(scope="module")
def solution(design_file: Path) -> Solution:
    return solve(load_design(design_file))


def test_each_sign_makes_its_torque_with_the_least_current(solution: Solution) -> None:
    """Against the formula of the leaning machine, by trying directions.

    The averaged machine would miss by 1.5 %.
    """
    reference = solution.reference
    assert isinstance(reference, SignedReference)
    most = float(reference.torque_max)
    for torque in np.array([-1.0, -0.7, -0.3, 0.3, 0.7, 1.0]) * 0.999 * most:
        i_d, i_q = (float(part[0]) for part in reference.currents(np.array([torque])))
        psi_d, psi_q = leaning(np.array([i_d]), np.array([i_q]))
        made = 1.5 * TRUE.pole_pairs * float((psi_d * i_q - psi_q * i_d)[0])
        assert made == pytest.approx(torque, abs=4e-3 * most)
        angle = np.sign(torque) * np.linspace(0.3, np.pi - 0.3, 20001)
        others_d, others_q = np.hypot(i_d, i_q) * np.cos(angle), np.hypot(i_d, i_q) * np.sin(angle)
        other_d, other_q = leaning(others_d, others_q)
        best = np.max(
            np.sign(torque) * 1.5 * TRUE.pole_pairs * (other_d * others_q - other_q * others_d)
        )
        assert abs(made) == pytest.approx(best, rel=2e-3)


@pytest.mark.slow
def test_the_averaged_reference_would_miss_the_torque(
    design_file: Path, solution: Solution
) -> None:
    averaged = solve(load_design(_with(design_file, "average")))
    assert averaged.negative is None
    half = np.array([0.5 * float(solution.reference.torque_max)])
    i_d, i_q = (part.astype(float) for part in averaged.reference.currents(half))
    psi_d, psi_q = leaning(i_d, i_q)
    made = 1.5 * TRUE.pole_pairs * (psi_d * i_q - psi_q * i_d)
    assert abs(made[0] / half[0] - 1.0) > 0.008


def _with(design_file: Path, symmetry: str) -> Path:
    other = design_file.with_name(f"{symmetry}.yaml")
    other.write_text(design_file.read_text().replace("symmetry: keep", f"symmetry: {symmetry}"))
    return other


def test_both_halves_are_proven_and_no_random_torque_breaks_the_bounds(solution: Solution) -> None:
    assert solution.negative is not None
    assert solution.design.halves is not None
    random = np.random.default_rng(5)
    for fit, proof, machine in (
        (solution.fit, solution.certificate, solution.design.halves[0]),
        (solution.negative.fit, solution.negative.certificate, solution.design.halves[1]),
    ):
        assert proof is not None
        torque = random.uniform(0.0, float(fit.reference.torque_max), 100_000).astype(np.float32)
        i_d, i_q = (part.astype(float) for part in fit.reference.currents(torque))
        assert np.max(np.abs(machine.torque(i_d, i_q) - torque)) <= proof.torque


def test_the_header_is_compiled_and_equals_the_model(solution: Solution) -> None:
    files = header_files(solution)
    found = verify_files(files, "mapped", solution.reference, 256)
    assert "C99" in [name.upper() for name in found.languages]
    header = files["mapped.h"].decode()
    assert "mapped_current_reference_negative" in header
    assert "MAPPED_TORQUE_MAX_NEGATIVE_NM" in header
    assert "apart;" in header
    assert max(len(line) for line in header.splitlines() if line.startswith(" *")) <= 120


def test_signed_references_survive_the_result(solution: Solution) -> None:
    plain = to_plain(solution.reference)
    again = from_plain(plain)
    torque = np.linspace(-500.0, 500.0, 1001).astype(np.float32)
    for one, other in zip(solution.reference.currents(torque), again.currents(torque), strict=True):
        np.testing.assert_array_equal(one, other)
    for broken in (None, 3, {"form": "polynomial"}):
        with pytest.raises(InputError):
            from_plain(plain | {"negative": broken})


@pytest.mark.slow
def test_a_written_folder_is_verified_with_both_signs(design_file: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as done:
        cli.main(["export", str(design_file), "-o", str(tmp_path), "--no-verify"])
    assert done.value.code == 0
    assert isinstance(read_folder(tmp_path).reference, SignedReference)
    assert verify_folder(tmp_path).vectors > 0


@pytest.mark.thinned
@pytest.mark.parametrize("command", ["mtpa", "fit"])
def test_commands_show_both_signs(
    command: str, design_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as done:
        cli.main([command, str(design_file)])
    assert done.value.code == 0
    assert "negative torques" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main([command, str(design_file), "--json"])
    assert f'"{command}_negative"' in capsys.readouterr().out
