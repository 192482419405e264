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

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.single_headers.field_weakening import (
    WEAKENING_HARNESS,
    least_voltage_text,
    percent,
    plain_weakening,
    plain_weakening_fit,
    weakening_currents,
    weakening_files,
    weakening_from,
    weakening_inputs,
    weakening_passage,
    weakening_tables,
)
from dqforge.reports.verification.host import WARNINGS

BUDGET = 0.005
SERVO = LinearMachine(
    pole_pairs=4, r_s=0.09, l_d=1e-4, l_q=1e-4, psi_pm=6.4e-3, i_max=15.0, inertia=1e-6
)
BENCH = LinearMachine(
    pole_pairs=3, r_s=2.35, l_d=6.5e-3, l_q=6.5e-3, psi_pm=0.06, i_max=6.4, inertia=1e-5
)
SMALL_IPM = LinearMachine(
    pole_pairs=3, r_s=1.1, l_d=3e-3, l_q=6e-3, psi_pm=0.05, i_max=8.0, inertia=1e-5
)
RPM = np.pi / 30.0

# Machine, phase voltage in V, mechanical speed in rad/s, bytes. R i is 0.6, 10, 14, 21, 18,
# 13 and 5 % of the voltage.
CASES: dict[str, tuple[Machine, float, float, int]] = {
    "interior": (IPM, 91.9, 300.0, 2048),
    "servo": (SERVO, 13.86, 5000.0 * RPM, 2048),
    "bench": (BENCH, 103.9, 5420.0 * RPM, 2048),
    "small ipm": (SMALL_IPM, 41.57, 4200.0 * RPM, 2048),
    "inverse": (INVERSE_SALIENT, 45.0, 300.0, 2400),
    "syrm": (catalogue.load("abb-syrm-6k7-saturated").machine, 140.6, 300.0, 2400),
    "pmsyrm": (catalogue.load("baldor-pmsyrm-5k6").machine, 372.0, 300.0, 3000),
}
SMALL = ("servo", "bench", "small ipm")
FAST = ("interior", *SMALL)
NAMES = [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in CASES]


@cache
def made(name: str) -> tuple[Design, WeakeningFit]:
    machine, v_max, omega_m, flash = CASES[name]
    design = make_design(IPM)
    design = replace(design, machine=machine, export=replace(design.export, prefix="drive"))
    return design, fit_weakening(
        machine, machine.i_max, v_max, WeakeningSettings(omega_m, flash=flash)
    )


def write(name: str, folder: Path) -> None:
    for file_name, content in weakening_files(*made(name)).items():
        (folder / file_name).write_bytes(content)


def compiled(name: str, folder: Path, inputs: SingleArray, *flags: str) -> SingleArray:
    """Currents by the compiled C, shape (N, 2)."""
    write(name, folder)
    harness = WEAKENING_HARNESS.source("drive")
    (folder / "harness.c").write_text(harness, encoding="ascii")
    command = ["cc", "-O2", *WARNINGS, *flags, "-o", "harness", "harness.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    # 1 says that test vectors differ, as they may where products and sums are fused.
    done = subprocess.run(
        [folder / "harness"], input=inputs.tobytes(), capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 0 or "-ffp-contract=fast" in flags
    return np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 2)


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("language", [("-std=c99",), ("-x", "c++", "-std=c++11")])
def test_compiled_code_equals_the_model_bit_for_bit(
    name: str, language: tuple[str, ...], tmp_path: Path
) -> None:
    reference = made(name)[1].step
    inputs = weakening_inputs(reference, 20_000, 1, patterns=20_000)
    found = compiled(name, tmp_path, inputs, *language, "-ffp-contract=off")
    assert np.all(np.isfinite(found))
    assert np.array_equal(
        found.view(np.uint32), weakening_currents(reference, inputs).view(np.uint32)
    )


def drawn(name: str, count: int, seed: int) -> SingleArray:
    """Random torques to beyond the largest, voltages from the least one, speeds to the largest,
    either direction.
    """
    fit = made(name)[1]
    generator = np.random.default_rng(seed)
    share = np.where(
        generator.uniform(size=count) < 0.5, 1.0, generator.uniform(LEAST_VOLTAGE, 1.5, count)
    )
    volts = fit.domain.v_max * share
    speed = fit.domain.omega_e * volts / fit.domain.v_max * generator.uniform(-1.0, 1.0, count)
    torque = generator.uniform(-1.1, 1.1, count) * fit.region.torque_max
    inputs = np.stack([torque, volts, speed], axis=1).astype(np.float32)
    # Rounding may put a speed a little above the largest one.
    inputs[:, 2] *= np.float32(1.0 - 1e-6)
    return np.ascontiguousarray(inputs)


def equations(
    machine: Machine, currents: FloatArray, omega: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Phase-voltage amplitude in V and torque in N m by the machine's equations,
    written out once more.
    """
    i_d, i_q = currents.T
    psi_d, psi_q = machine.flux(i_d, i_q)
    v_d, v_q = machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d
    return np.hypot(v_d, v_q), 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)


@pytest.mark.thinned
@pytest.mark.parametrize("contract", ["off", "fast"])
@pytest.mark.parametrize("name", NAMES)
def test_compiled_code_keeps_voltage_and_current_at_a_million_torques_and_speeds(
    name: str, contract: str, tmp_path: Path
) -> None:
    fit, machine = made(name)[1], CASES[name][0]
    inputs = drawn(name, 1_000_000, 11)
    flags = [
        f"-ffp-contract={contract}",
        *(["-std=gnu99", "-march=native"] if contract == "fast" else []),
    ]
    currents = compiled(name, tmp_path, inputs, *flags).astype(np.float64)
    voltage, _ = equations(machine, currents, inputs[:, 2].astype(np.float64))
    proof = fit.certificate
    assert proof is not None
    assert proof.voltage_excess is not None
    excess = np.max(voltage / inputs[:, 1]) - 1.0
    assert excess <= proof.voltage_excess
    assert excess <= BUDGET
    assert np.max(np.hypot(*currents.T)) / machine.i_max - 1.0 <= proof.current_excess
    header = weakening_files(*made(name))["drive_weakening.h"].decode("ascii")
    assert f"exceeds its limit by {rounded_up(100.0 * proof.voltage_excess)} % (" in header


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMES)
def test_compiled_code_makes_what_can_be_had_motoring_and_generating(
    name: str, tmp_path: Path
) -> None:
    """Against the operating points within the voltage limit, which know the
    resistance and nothing of surfaces.
    """
    fit, machine = made(name)[1], CASES[name][0]
    speeds = np.linspace(-1.0, 1.0, 40) * fit.domain.omega_e * (1.0 - 1e-6)
    torque = np.linspace(-1.1, 1.1, 45) * fit.region.torque_max
    mesh = [part.ravel() for part in np.meshgrid(torque, [fit.domain.v_max], speeds)]
    inputs = np.ascontiguousarray(np.stack(mesh, axis=1).astype(np.float32))
    currents = compiled(name, tmp_path, inputs, "-ffp-contract=off").astype(np.float64)
    asked, volts, omega = inputs.astype(np.float64).T
    best = optimal_points(
        machine, asked, omega / machine.pole_pairs, v_max=volts, i_max=machine.i_max
    )
    _, made_torque = equations(machine, currents, omega)
    assert np.max(np.abs(made_torque - best.torque)) <= BUDGET * fit.region.torque_max
    loaded = best.reached & (np.abs(asked) > 0.05 * fit.region.torque_max)
    loss = np.sum(currents**2, axis=1)[loaded] / (best.i_d**2 + best.i_q**2)[loaded]
    assert np.max(loss) < 1.15
    assert np.mean(loss) < 1.01


@pytest.mark.thinned
@pytest.mark.parametrize("name", SMALL)
def test_the_drop_matters_in_these_cases(name: str) -> None:
    """Currents for the whole voltage over the speed, without the drop, leave the
    limit by several per cent.
    """
    fit, machine = made(name)[1], CASES[name][0]
    inputs = drawn(name, 20_000, 12)
    flux = inputs[:, 1] / np.maximum(np.abs(inputs[:, 2]), np.float32(1.0)).astype(np.float32)
    currents = np.stack(
        fit.reference.currents(inputs[:, 0], flux.astype(np.float32)), axis=1
    ).astype(np.float64)
    voltage, _ = equations(machine, currents, inputs[:, 2].astype(np.float64))
    assert np.max(voltage / inputs[:, 1]) > 1.03


def test_with_fused_operations_the_errors_stay_what_they_are(tmp_path: Path) -> None:
    reference = made("servo")[1].step
    inputs = weakening_inputs(reference, 5000, 2)
    found = compiled("servo", tmp_path, inputs, "-std=gnu99", "-march=native", "-ffp-contract=fast")
    assert (
        np.max(np.abs(found - weakening_currents(reference, inputs)))
        < 1e-3 * CASES["servo"][0].i_max
    )


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("contract", ["off", "fast"])
@pytest.mark.parametrize("level", ["-O2", "-Os"])
def test_the_evaluator_takes_no_more_than_stated_on_a_cortex_m4(
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
        "void go(float t, float v, float w, float *d, float *q);",
        (
            "void go(float t, float v, float w, float *d, float *q) { drive_weakening_reference(t, "
            "v, w, d, q); }"
        ),
    ]
    (tmp_path / "size.c").write_text("\n".join(lines) + "\n", encoding="ascii")
    core = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
    command = [
        "arm-none-eabi-gcc",
        *core,
        level,
        f"-ffp-contract={contract}",
        "-ffreestanding",
        "-c",
        "size.c",
    ]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    listing = subprocess.run(
        ["arm-none-eabi-size", "size.o"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    text, data, bss = (int(value) for value in listing.stdout.splitlines()[1].split()[:3])
    assert (data, bss) == (0, 0)
    assert text <= made(name)[1].step.flash <= CASES[name][3]
    if (level, contract) == ("-O2", "off"):
        assert (
            text >= 0.75 * made(name)[1].step.flash
        )  # an estimate that is too high refuses what would do


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMES)
def test_plain_data_rebuild_the_model(name: str) -> None:
    reference = made(name)[1].step
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
        {"drop": {}},
        {"drop": None},
    ],
)
def test_damaged_data_are_refused(damage: dict[str, Any]) -> None:
    plain = plain_weakening(made("interior")[1].step)
    with pytest.raises(InputError, match="run the design again"):
        weakening_from(plain | damage)


@pytest.mark.parametrize(
    "damage", [{"passes": 3}, {"passes": True}, {"near": [1.0]}, {"square": "1"}, {"reserve": None}]
)
def test_a_damaged_drop_is_refused(damage: dict[str, Any]) -> None:
    plain = plain_weakening(made("interior")[1].step)
    with pytest.raises(InputError, match="run the design again"):
        weakening_from(plain | {"drop": plain["drop"] | damage})


def test_the_header_states_its_errors_with_units_and_for_which_resistance() -> None:
    design, fit = made("interior")
    text = weakening_files(design, fit)["drive_weakening.h"].decode("ascii")
    for phrase in (
        "The phase resistance is 0.002 Ohm",
        "% of the largest one, 205.973 N m (",
        "proven for every torque and speed up to the largest, against the equations of the machine",
        "Not-a-number",
        "_WEAKENING_FLUX_MIN_WB",
        "Sampled, not proven:",
    ):
        assert phrase in text
    assert fit.certificate is not None
    assert fit.certificate.voltage_excess is not None
    assert f"{rounded_up(100.0 * fit.certificate.torque_relative)} % of the largest one" in text
    assert f"exceeds its limit by {rounded_up(100.0 * fit.certificate.voltage_excess)} % (" in text
    assert f"its limit by {rounded_up(100.0 * fit.certificate.current_excess)} % (" in text
    unproven = weakening_files(design, replace(fit, certificate=None))["drive_weakening.h"].decode(
        "ascii"
    )
    assert "Sampled, not proven, for voltages" in unproven
    assert "proven for every" not in unproven
    partly = replace(fit, certificate=replace(fit.certificate, voltage_excess=None))
    assert "exceeds its limit by no proven bound" in weakening_files(design, partly)[
        "drive_weakening.h"
    ].decode("ascii")
    assert all(line == line.rstrip() for line in text.splitlines())
    assert weakening_files(design, fit) == weakening_files(design, fit)


def test_header_json_report_and_terminal_state_the_same_errors_over_the_link() -> None:
    """Each number is the result's own, and each line names its voltages."""
    design, fit = made("small ipm")
    voltage, torque_max = fit.voltage, fit.region.torque_max
    header = " ".join(
        weakening_files(design, fit)["drive_weakening.h"]
        .decode("ascii")
        .replace(" * ", " ")
        .split()
    )
    plain = plain_weakening_fit(fit)
    assert plain is not None
    assert plain["voltage_errors"]["loss_relative"] == voltage.loss_relative
    assert plain["voltage_errors"]["missed"] == voltage.missed
    assert plain["voltages_V"] == list(fit.domain.voltages)
    assert plain["v_least_V"] == LEAST_VOLTAGE * fit.domain.v_max == min(plain["voltages_V"])
    whole, missed, loss, nominal, nominal_loss = (
        percent(value)
        for value in (
            fit.largest_torque_error / torque_max,
            voltage.missed,
            voltage.loss_relative,
            voltage.torque_nominal / torque_max,
            voltage.loss_nominal,
        )
    )
    assert nominal != whole
    volts = f"{fit.domain.v_max:.6g} V"
    for phrase in (
        f"from {fit.domain.voltages[0]:.6g} V up for speeds up to the largest in proportion",
        f"granted to within {whole} of the largest one, and to within {missed} of what voltage",
        f"({nominal} of the largest at {volts})",
        f"up to {loss} above the least ({nominal_loss} at {volts})",
        f"at 0.8, 0.9, 1, 1.2, 1.6 and 4 times {volts}",
    ):
        assert phrase in header
    (said,) = weakening_passage(fit, "drive").text
    notes = weakening_tables(fit)[0].notes
    for text in (str(said), " ".join(notes)):
        for number in (
            f"torque {whole}", f"copper loss +{loss}", f"at most {missed}", f"torque {nominal}",
            f"copper loss +{nominal_loss}", f"from {least_voltage_text(fit)} up",
        ):  # fmt: skip
            assert number in text


def test_bounds_and_what_was_found_speak_of_the_same_points() -> None:
    for name in FAST:
        fit = made(name)[1]
        proof = fit.certificate
        assert proof is not None
        assert proof.voltage_excess is not None
        assert fit.voltage.voltage_excess <= proof.voltage_excess
        assert fit.largest_current_excess <= proof.current_excess
        assert fit.errors.torque_relative <= proof.torque_relative
