"""The emitted field-weakening reference: compiled, run, weighed, and read back."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, make_design

from dqforge.machines import catalogue
from dqforge.machines.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.settings import WeakeningSettings
from dqforge.optimizer.single_precision import SingleArray
from dqforge.optimizer.surface_fit import WeakeningFit, fit_weakening
from dqforge.reports.c_numbers import rounded_up
from dqforge.reports.surface_header import (
    plain_weakening,
    weakening_currents,
    weakening_files,
    weakening_from,
    weakening_inputs,
)
from dqforge.reports.templating import render
from dqforge.reports.verify import WARNINGS

BUDGET = 0.005
CASES = {
    "interior": (make_design(IPM), 0.0766),
    "inverse": (make_design(INVERSE_SALIENT), 0.05),
    "syrm": (catalogue.load("abb-syrm-6k7-saturated"), 0.2344),
    "pmsyrm": (catalogue.load("baldor-pmsyrm-5k6"), 0.4135),
}


@cache
def made(name: str) -> tuple[Design, WeakeningFit]:
    design, flux_min = CASES[name]
    design = replace(design, export=replace(design.export, prefix="drive"))
    v_max = 300.0 * design.machine.pole_pairs * flux_min
    return design, fit_weakening(design.machine, design.i_max, v_max, WeakeningSettings(300.0))


def write(name: str, folder: Path) -> None:
    for file_name, content in weakening_files(*made(name)).items():
        (folder / file_name).write_bytes(content)


def compiled(name: str, folder: Path, inputs: SingleArray, *flags: str) -> SingleArray:
    """Currents by the compiled C, shape (N, 2)."""
    write(name, folder)
    harness = render("surface_harness.c.j2", {"prefix": "drive", "macro": "DRIVE"})
    (folder / "harness.c").write_text(harness, encoding="ascii")
    command = ["cc", "-O2", *WARNINGS, *flags, "-o", "harness", "harness.c"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    # 1 says that test vectors differ, as they may where products and sums are fused.
    done = subprocess.run([folder / "harness"], input=inputs.tobytes(), capture_output=True, timeout=60, check=False)
    assert done.returncode == 0 or "-ffp-contract=fast" in flags
    return np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 2)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("language", [("-std=c99",), ("-x", "c++", "-std=c++11")])
def test_compiled_code_equals_the_model_bit_for_bit(name: str, language: tuple[str, ...], tmp_path: Path) -> None:
    reference = made(name)[1].reference
    inputs = weakening_inputs(reference, 20_000, 1, patterns=20_000)
    found = compiled(name, tmp_path, inputs, *language, "-ffp-contract=off")
    assert np.all(np.isfinite(found))
    assert np.array_equal(found.view(np.uint32), weakening_currents(reference, inputs).view(np.uint32))


@pytest.mark.parametrize("name", CASES)
def test_compiled_code_keeps_the_budget_at_200000_random_points(name: str, tmp_path: Path) -> None:
    design, fit = made(name)
    region, machine = fit.region, design.machine
    generator = np.random.default_rng(11)
    flux = generator.uniform(region.flux_min, 1.02 * region.flux_max, 200_000).astype(np.float32)
    torque = (generator.uniform(-1.05, 1.05, flux.size) * region.torque_max).astype(np.float32)
    currents = compiled(name, tmp_path, np.stack([torque, flux], axis=1), "-ffp-contract=off").astype(np.float64)
    available = np.maximum(flux.astype(np.float64), region.flux_min)
    grid = np.linspace(region.flux_min, region.flux_max, 2001)
    most = np.interp(available, grid, region.largest_torque(grid))
    made_torque = machine.torque(currents[:, 0], currents[:, 1])
    error = np.max(np.abs(made_torque - np.clip(torque, -most, most)))
    excess = np.max(np.hypot(*machine.flux(currents[:, 0], currents[:, 1])) / available) - 1.0
    over = np.max(np.hypot(currents[:, 0], currents[:, 1])) / design.i_max - 1.0
    assert error <= BUDGET * region.torque_max
    assert max(excess, over) <= BUDGET
    # What the header states holds at these points, too: it was found on a grid that knows nothing of them.
    assert error <= 1.02 * fit.errors.torque
    assert excess <= fit.errors.flux_excess + 1e-4


def test_with_fused_operations_the_errors_stay_what_they_are(tmp_path: Path) -> None:
    reference = made("pmsyrm")[1].reference
    inputs = weakening_inputs(reference, 5000, 2)
    found = compiled("pmsyrm", tmp_path, inputs, "-std=gnu99", "-march=native", "-ffp-contract=fast")
    assert np.max(np.abs(found - weakening_currents(reference, inputs))) < 1e-3 * made("pmsyrm")[0].i_max


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("contract", ["off", "fast"])
@pytest.mark.parametrize("level", ["-O2", "-Os"])
def test_the_evaluator_takes_less_than_2_kib_on_a_cortex_m4(
    name: str, contract: str, level: str, tmp_path: Path
) -> None:
    for tool in ("arm-none-eabi-gcc", "arm-none-eabi-size"):
        if shutil.which(tool) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{tool} is missing; CI needs it")
            pytest.skip(f"{tool} is not installed")
    write(name, tmp_path)
    lines = [
        '#include "drive_weakening.h"',
        "void go(float t, float a, float *d, float *q);",
        "void go(float t, float a, float *d, float *q) { drive_weakening_reference(t, a, d, q); }",
    ]
    (tmp_path / "size.c").write_text("\n".join(lines) + "\n", encoding="ascii")
    core = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
    command = ["arm-none-eabi-gcc", *core, level, f"-ffp-contract={contract}", "-ffreestanding", "-c", "size.c"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    listing = subprocess.run(
        ["arm-none-eabi-size", "size.o"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=60
    )
    text, data, bss = (int(value) for value in listing.stdout.splitlines()[1].split()[:3])
    assert (data, bss) == (0, 0)
    assert text <= made(name)[1].reference.flash <= 2048
    if (level, contract) == ("-O2", "off"):
        assert text >= 0.75 * made(name)[1].reference.flash  # an estimate that is too high refuses what would do


@pytest.mark.parametrize("name", CASES)
def test_plain_data_rebuild_the_model(name: str) -> None:
    reference = made(name)[1].reference
    inputs = weakening_inputs(reference, 500, 4)
    again = weakening_from(plain_weakening(reference))
    assert np.array_equal(weakening_currents(again, inputs), weakening_currents(reference, inputs))


@pytest.mark.parametrize(
    "damage",
    [
        {"flux_min": "0.1"},
        {"flux_max": None},
        {"limit": []},
        {"d": [{"start": 1.0, "coefficients": [0.0, 1.0]}]},
        {"q": [{"start": 0.0, "coefficients": [0.0]}]},
        {"surface_d": [[1.0]]},
        {"surface_q": [[1e300]]},
        {"torque_mid": True},
    ],
)
def test_damaged_data_are_refused(damage: dict[str, Any]) -> None:
    plain = plain_weakening(made("interior")[1].reference)
    with pytest.raises(InputError, match="run the design again"):
        weakening_from(plain | damage)


def test_the_header_states_its_errors_with_units_and_what_it_neglects() -> None:
    design, fit = made("interior")
    text = weakening_files(design, fit)["drive_weakening.h"].decode("ascii")
    for phrase in (
        "phase resistance is neglected",
        "% of the largest one, 205.973 N m (",
        "proven for every torque and flux linkage",
        "Not-a-number",
        "_WEAKENING_FLUX_MIN_WB",
    ):
        assert phrase in text
    assert "math.h" not in text
    assert fit.certificate is not None
    assert f"{rounded_up(100.0 * fit.certificate.torque_relative)} % of the largest one" in text
    assert f"available one by {rounded_up(100.0 * fit.certificate.flux_excess)} % (" in text
    assert f"its limit by {rounded_up(100.0 * fit.certificate.current_excess)} % (" in text
    assert "proven for every torque and flux linkage, against the equations of the machine" in text
    assert "Sampled, not proven: copper loss" in text
    unproven = weakening_files(design, replace(fit, certificate=None))["drive_weakening.h"].decode("ascii")
    assert "sampled, not proven" in unproven
    assert "proven for every" not in unproven
    assert all(line == line.rstrip() for line in text.splitlines())
    assert weakening_files(design, fit) == weakening_files(design, fit)
