"""Three million inputs per form through the compiled C: no proven bound is violated.

The exact currents come from Newton's method on the optimality conditions in doubles,
written here once more.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.forms import PENALTY_FROM, FixedReference
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.current_reference.plain import reference_harness
from dqforge.reports.main_header import header_files

INPUTS = 3_000_000
CHUNK = 1_000_000
ROUNDING = 2e-13  # Of the largest current or torque: what Newton's method in doubles leaves open.

CASES: dict[str, tuple[LinearMachine, FitSettings]] = {
    "polynomial": (IPM, FitSettings(form="polynomial", degree=4)),
    "polynomial own": (
        INVERSE_SALIENT,
        FitSettings(form="polynomial", degree=3, segments=3, breakpoint_mode="own"),
    ),
    "even-odd": (IPM, FitSettings(form="even-odd", degree=3, segments=1)),
    "torque-exact": (IPM, FitSettings()),
    "closed-form": (IPM, FitSettings(form="closed-form", degree=3)),
    "proportional": (SURFACE, FitSettings()),
    "reluctance": (RELUCTANCE, FitSettings(form="closed-form")),
    "q15": (IPM, FitSettings(form="polynomial", degree=4, format="q15")),
    "q31": (IPM, FitSettings(form="polynomial", degree=5, format="q31")),
}


def exact_currents(machine: LinearMachine, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least current for torques >= 0, (N,): Newton on k i_q (psi - dl i_d) = T
    with i_d on the MTPA locus.
    """
    k, psi, dl = 1.5 * machine.pole_pairs, machine.psi_pm, machine.l_q - machine.l_d
    if dl == 0.0:
        return np.zeros_like(torque), torque / (k * psi)
    if psi == 0.0:
        i_q = np.sqrt(torque / (k * abs(dl)))
        return -np.sign(dl) * i_q, i_q
    base = psi / (2.0 * abs(dl))

    def locus(i_q: FloatArray) -> FloatArray:
        return np.asarray(-np.sign(dl) * i_q**2 / (base + np.hypot(base, i_q)))

    i_q = torque / (k * psi)
    for _ in range(60):
        root = np.hypot(base, i_q)
        made = k * i_q * (psi - dl * locus(i_q))
        slope = k * (psi - dl * locus(i_q)) + k * abs(dl) * i_q * i_q / root
        step = (made - torque) / slope
        i_q = i_q - step
        if float(np.max(np.abs(step), initial=0.0)) <= 1e-15 * machine.i_max:
            break
    return locus(i_q), i_q


def compiled(folder: Path, solution: Solution, flags: list[str]) -> Path:
    for name, content in header_files(solution).items():
        (folder / name).write_bytes(content)
    (folder / "main.c").write_text(reference_harness(solution.reference).source("drive"))
    command = ["gcc", "-O2", *flags, "-w", "main.c", "-lm", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    return folder / "main"


def neighbours(places: list[float], reach: int) -> NDArray[np.float32]:
    """All floats within so many units in the last place."""
    bits = np.array(places, dtype=np.float32).view(np.int32)[:, np.newaxis] + np.arange(
        -reach, reach + 1, dtype=np.int32
    )
    return np.maximum(bits, 0).ravel().astype(np.int32).view(np.float32)


def adversarial(solution: Solution) -> NDArray[np.float32]:
    end = float(solution.fit.torque_max)
    polynomials = [p for p in (solution.fit.d, solution.fit.q) if p is not None]
    edges = [float(edge) for p in polynomials for edge in p.breakpoints]
    tiny = np.geomspace(1e-44, 1e-6 * end, 5000).astype(np.float32)
    return np.concatenate([neighbours([end, *edges], 1000), tiny, -tiny])


def batches(solution: Solution, generator: np.random.Generator) -> list[NDArray[np.generic]]:
    """Inputs in the number type of the evaluator, in batches of at most a million."""
    reference = solution.fit.reference
    if isinstance(reference, FixedReference) and reference.width == 16:
        return [np.arange(-(2**15), 2**15).astype(np.int16)]
    found: list[NDArray[np.generic]] = []
    for _ in range(INPUTS // CHUNK):
        if isinstance(reference, FixedReference):
            found.append(
                generator.integers(-reference.end, reference.end + 1, CHUNK).astype(np.int32)
            )
        else:
            end = float(reference.torque_max)
            even = generator.uniform(-end, end, CHUNK // 2)
            log = 10.0 ** generator.uniform(-9.0, 0.0, CHUNK // 2) * end
            found.append(np.concatenate([even, log]).astype(np.float32))
    return found if isinstance(reference, FixedReference) else [*found, adversarial(solution)]


def worst(solution: Solution, program: Path, inputs: NDArray[np.generic]) -> FloatArray:
    """Largest errors of i_d and i_q in A, torque in N m, loss in W, and relative loss,
    in what the program returns.
    """
    # It ends with 1 where contraction makes other bits than the test vectors have.
    done = subprocess.run(
        [str(program)], input=inputs.tobytes(), capture_output=True, check=False, timeout=120
    )
    assert done.returncode in (0, 1)
    results = np.frombuffer(done.stdout, dtype=inputs.dtype).reshape(-1, 2)
    machine, reference = solution.design.machine, solution.fit.reference
    assert isinstance(machine, LinearMachine)
    torque, currents = inputs.astype(np.float64), results.astype(np.float64)
    if isinstance(reference, FixedReference):
        scale = reference.scale
        torque, currents = (
            torque * (scale.argument / scale.one),
            currents * (scale.result / scale.one),
        )
    inside = np.abs(torque) <= float(reference.torque_max)
    torque, i_d, i_q = (
        torque[inside],
        currents[inside, 0],
        currents[inside, 1] * np.sign(torque[inside]),
    )
    size = np.abs(torque)
    exact_d, exact_q = exact_currents(machine, size)
    made = 1.5 * machine.pole_pairs * (machine.psi_pm + (machine.l_d - machine.l_q) * i_d) * i_q
    least_d, least_q = exact_currents(machine, np.abs(made))
    least = 1.5 * machine.r_s * (least_d**2 + least_q**2)
    more = 1.5 * machine.r_s * (i_d**2 + i_q**2) - least
    loaded = size >= PENALTY_FROM * float(reference.torque_max)
    found = [
        np.abs(i_d - exact_d),
        np.abs(i_q - exact_q),
        np.abs(made - size),
        more,
        (more / np.maximum(least, 1e-300))[loaded],
    ]
    return np.array([float(np.max(values, initial=0.0)) for values in found])


def limits(certificate: Certificate, solution: Solution) -> FloatArray:
    bounds = [
        certificate.i_d,
        certificate.i_q,
        certificate.torque,
        certificate.loss,
        certificate.loss_relative,
    ]
    machine, i_max = solution.design.machine, solution.design.i_max
    scales = [i_max, i_max, solution.fit.torque_max, 1.5 * machine.r_s * i_max**2, 1.0]
    return np.array(
        [(np.inf if b is None else b) + ROUNDING * s for b, s in zip(bounds, scales, strict=True)]
    )


def has_fma() -> bool:
    return "fma" in Path("/proc/cpuinfo").read_text().split()


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_no_bound_is_violated(case: str, tmp_path: Path) -> None:
    machine, fit = CASES[case]
    solution = solve(make_design(machine, fit=fit))
    assert solution.certificate is not None
    allowed = limits(solution.certificate, solution)
    assert np.all(np.isfinite(allowed))
    ways = [["-std=c99", "-ffp-contract=off"]]
    if has_fma() and not isinstance(solution.fit.reference, FixedReference):
        ways.append(["-std=gnu99", "-mfma", "-ffp-contract=fast"])
    generator = np.random.default_rng(20)
    largest = np.zeros(5)
    for number, flags in enumerate(ways):
        folder = tmp_path / str(number)
        folder.mkdir()
        program = compiled(folder, solution, flags)
        # The second way takes a tenth of the inputs: the operations are the
        # same but for their roundings.
        for inputs in batches(solution, generator)[:: 1 if number == 0 else 10]:
            largest = np.maximum(largest, worst(solution, program, inputs))
    assert np.all(largest <= allowed), (largest / allowed).tolist()
    # And the bounds are no idle ones: those of the currents are nearly reached
    # wherever the fit errs visibly.
    for found, bound, scale in zip(
        largest[:2], allowed[:2], (machine.i_max, machine.i_max), strict=True
    ):
        assert found >= 0.7 * bound or bound < 3e-7 * scale
