"""Records of the modulators: one for every word, further ones while they are registered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast, get_args

import numpy as np
import pytest
from worked_examples import module_of, text_of

from dqforge.machines.design.sections.losses import LossSection
from dqforge.machines.design.sections.modulation_choice import ChoiceSection
from dqforge.machines.modulation.modulator import Modulator
from dqforge.machines.modulation.modulators import (
    SIX_STEP_AMPLITUDE,
    linear_limit,
    period_waveforms,
    sector_waveforms,
)
from dqforge.machines.modulation.registry import MODULATORS, registered, switching_loss_factor
from dqforge.machines.modulation.ripple import flux_moments, harmonic_distortion_factor
from dqforge.machines.modulation.switched_period import fundamental, saturate
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import dq_to_phases

EXAMPLE = "machines/modulation/families/fifth_of_third_harmonic.py"
NAME = cast(ModulationName, "thipwm5")


@pytest.fixture
def example(tmp_path: Path) -> Modulator:
    with module_of(EXAMPLE, tmp_path) as file:
        (record,) = file.MODULATORS
    assert isinstance(record, Modulator)
    return record


def test_every_word_has_a_record_and_every_record_a_word() -> None:
    assert tuple(MODULATORS) == get_args(ModulationName)
    assert all(record.name == name for name, record in MODULATORS.items())
    families = Path(__file__).parents[3] / "machines" / "modulation" / "families"
    written = "".join(file.read_text() for file in families.glob("*.py"))
    assert written.count("name=") == len(MODULATORS)
    assert all(f'name="{name}"' in written for name in MODULATORS)


def test_rules_are_told_whole() -> None:
    for name, record in MODULATORS.items():
        assert (record.share > 0.0) == (record.kind == "third-harmonic"), name
        assert (record.compared != "none") == (record.kind == "compared"), name
        assert (record.delay is not None) == (record.compared == "seen later"), name
        assert record.rests == (record.mean_loss_factor < 1.0), name


def test_lists_of_a_design_hold_as_many_as_there_are() -> None:
    for section in (LossSection, ChoiceSection):
        bounds = str(section.model_fields["modulations"])
        assert f"max_length={len(MODULATORS)}" in bounds
        assert "min_length=1" in bounds


def test_a_registered_modulator_is_one_of_the_package(example: Modulator) -> None:
    """Its figures, found here by brute force on its waveforms."""
    with registered(example):
        assert list(MODULATORS)[-1] == NAME
        limit = linear_limit(NAME, 1.0)
        wave = period_waveforms(NAME, limit, 0.0, 1.0, 0.0, 1.0, angles=14400)
        assert np.ptp(wave.modulation.duty) == pytest.approx(1.0, abs=1e-6)
        theta = (np.arange(14400) + 0.5) * (2.0 * np.pi / 14400)
        beyond = saturate(
            NAME,
            dq_to_phases(np.full(14400, 0.7), np.zeros(14400), theta),
            np.zeros((14400, 3)),
            1.0,
        )
        found = 2.0 * np.mean(beyond.duty[:, 0] * np.cos(theta))
        assert float(fundamental(NAME, 0.7, 1.0)) == pytest.approx(float(found), rel=1e-6)
        assert float(switching_loss_factor(NAME, 0.3)) == 1.0
        wave = sector_waveforms(NAME, 0.5, 0.0, 1.0, 0.0, 1.0)
        moments = flux_moments(wave.modulation.duty)
        own = np.trace(moments, axis1=-2, axis2=-1)
        square = (2.0 * own - 2.0 / 3.0 * np.sum(moments, axis=(-2, -1))) / 3.0
        factor = float(harmonic_distortion_factor(NAME, 0.5 / SIX_STEP_AMPLITUDE))
        assert factor == pytest.approx(288.0 * float(np.sum(wave.weight * square)), rel=1e-9)
    assert NAME not in MODULATORS


def test_a_name_that_is_taken_is_refused_and_nothing_stays(example: Modulator) -> None:
    taken = replace(example, name="svpwm")
    with pytest.raises(ValueError, match="svpwm"), registered(example, taken):
        pass
    assert tuple(MODULATORS) == get_args(ModulationName)


def test_the_page_names_the_word() -> None:
    assert text_of("machines/names.py", 0).strip() == f'"{NAME}",'
