"""Headers as texts and in folders, and what their verification finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dqforge
from dqforge import cli

MACHINE = dqforge.LinearMachine(
    pole_pairs=4, r_s=0.02, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=300.0
)


@pytest.fixture(scope="module")
def emission() -> dqforge.Emission:
    design = dqforge.make_design(
        MACHINE, v_dc=400.0, f_sw=10e3, prefix="emitted", fit={"degree": 2}
    )
    return dqforge.emit(design)


def test_an_emission_holds_the_texts_and_proves_itself(emission: dqforge.Emission) -> None:
    assert {"emitted.h", "emitted_certificate.json", "emitted_vectors.h", "result.json"} == set(
        emission.files
    )
    assert "static inline void emitted_current_reference(" in emission.header
    proof = dqforge.verify(emission)
    assert proof.languages[0] == "c99"
    assert proof.compared > 20_000
    assert proof.to_dict()["compared"] == proof.compared
    shown = emission._repr_html_()
    assert "emitted_vectors.h" in shown
    assert "#define" not in shown


@pytest.mark.thinned
@pytest.mark.parametrize("place", ["emitted.h", "emitted_vectors.h", "result.json"])
def test_a_changed_file_is_found(emission: dqforge.Emission, place: str) -> None:
    """One digit of one number anywhere."""
    text = emission.files[place]
    digit = next(
        k
        for k in range(len(text) // 2, len(text))
        if text[k] in "12345678" and text[k - 1] in ".0123456789"
    )
    changed = text[:digit] + str(int(text[digit]) + 1) + text[digit + 1 :]
    with pytest.raises(dqforge.VerificationError, match=rf"^{place}:\d+: "):
        dqforge.verify(replace(emission, files={**emission.files, place: changed}))


@pytest.mark.slow
def test_a_missing_file_is_found(emission: dqforge.Emission) -> None:
    fewer = {name: text for name, text in emission.files.items() if name != "emitted_vectors.h"}
    with pytest.raises(dqforge.VerificationError, match=r"emitted_vectors\.h"):
        dqforge.verify(replace(emission, files=fewer))


@pytest.mark.slow
def test_a_folder_is_computed_again_from_the_design_in_it(
    emission: dqforge.Emission, tmp_path: Path
) -> None:
    """A machine from Python leaves a design file behind that gives the same bytes."""
    emission.write(tmp_path / "out")
    assert (tmp_path / "out" / "emitted.h").read_text() == emission.header
    proof = dqforge.verify(tmp_path / "out")
    assert proof.computed_again is not None
    header = tmp_path / "out" / "emitted.h"
    header.write_text(emission.header.replace("EMITTED_POLE_PAIRS (4)", "EMITTED_POLE_PAIRS (5)"))
    assert header.read_text() != emission.header
    with pytest.raises(dqforge.VerificationError, match="EMITTED_POLE_PAIRS"):
        dqforge.verify(str(tmp_path / "out"))
    again = dqforge.load_design(tmp_path / "out" / "dqforge-input" / "design.yaml")
    assert again.machine == MACHINE


@pytest.mark.slow
def test_texts_are_those_of_the_command(tmp_path: Path) -> None:
    name = "abb-ipmsm-2k2"
    with pytest.raises(SystemExit):
        cli.main(["export", name, "-o", str(tmp_path / "out"), "--no-verify"])
    for file, text in dqforge.emit(dqforge.load_design(name)).files.items():
        assert (tmp_path / "out" / file).read_text(encoding="utf-8") == text


@pytest.mark.slow
def test_a_map_of_scattered_points_is_emitted_and_compiled(tmp_path: Path) -> None:
    """No design file says where its data end.

    The folder holds none, and verification says that it did not use one.
    """
    generator = np.random.default_rng(3)
    i_d, i_q = generator.uniform(-160.0, 0.0, 300), generator.uniform(0.0, 160.0, 300)
    flux_map = dqforge.make_flux_map(i_d, i_q, 0.1 + 3e-4 * i_d, 6e-4 * i_q)
    assert flux_map.hull is not None
    machine = dqforge.SaturatedMachine(pole_pairs=4, r_s=0.02, flux_map=flux_map, i_max=100.0)
    fit = {"degree": 2, "max_torque": 60.0}
    design = dqforge.make_design(machine, v_dc=400.0, f_sw=10e3, fit=fit, control={"gains": False})
    other = dqforge.make_flux_map(0.9 * i_d, i_q, 0.1 + 3e-4 * 0.9 * i_d, 6e-4 * i_q)
    moved = dqforge.make_design(replace(machine, flux_map=other), v_dc=400.0, f_sw=10e3, fit=fit)
    assert design.machine is machine
    assert design.digest != moved.digest
    dqforge.emit(design, tmp_path / "out")
    proof = dqforge.verify(tmp_path / "out")
    assert proof.computed_again is None
    assert proof.compared > 20_000


def test_a_folder_of_others_is_refused(tmp_path: Path) -> None:
    with pytest.raises(dqforge.InputError):
        dqforge.verify(tmp_path)


def test_a_solution_holds_its_parts() -> None:
    solution = dqforge.solve(dqforge.load_design("paper001-pmsm-bench"))
    assert isinstance(solution, dqforge.Solution)
    assert solution.tuning is not None
    plain = solution.to_dict()
    assert plain["gains"]["i_q"]["kp"] == solution.tuning.gains.i_q.kp
    assert solution.waveforms is None
    assert "pole_pairs" in solution._repr_html_()
