"""Ten million inputs through the compiled header of every form: none leaves the bounds that are proven."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, SURFACE, make_design
from exact_currents import edges_of, neighbours
from numpy.typing import NDArray

from dqforge.machines.settings import FitSettings
from dqforge.machines.synchronous import FloatArray, LinearMachine
from dqforge.optimizer.certificate import Certificate
from dqforge.optimizer.current_reference import PENALTY_FROM, CurrentReference
from dqforge.optimizer.fixed_reference import FixedReference
from dqforge.optimizer.mtpa import mtpa_currents
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.header import header_files

INPUTS = 10_000_000
CHUNK = 500_000

ROUNDING = 1e-13
"""Relative error of the closed form in double, against which the currents are held."""

SCALES = (215.0, 283.0)

CASES: dict[str, tuple[LinearMachine, FitSettings]] = {
    "polynomial": (IPM, FitSettings(form="polynomial", degree=3, breakpoint_mode="own")),
    "even-odd": (IPM, FitSettings(form="even-odd", degree=3)),
    "torque-exact": (IPM, FitSettings()),
    "closed-form": (IPM, FitSettings(form="closed-form", degree=3)),
    "proportional": (SURFACE, FitSettings()),
    "square-root": (RELUCTANCE, FitSettings(form="closed-form")),
    "q15": (IPM, FitSettings(form="polynomial", degree=3, format="q15", full_scale=SCALES)),
    "q31": (IPM, FitSettings(form="polynomial", degree=4, format="q31", full_scale=SCALES)),
}

MAIN = """
#include <stdio.h>
#include "drive.h"
#define BLOCK 4096
static {input} in[BLOCK];
static {input} out[2 * BLOCK];
int main(void)
{{
    size_t n;
    while ((n = fread(in, sizeof in[0], BLOCK, stdin)) > 0U) {{
        for (size_t k = 0; k < n; k++) {{
            drive_current_reference{suffix}(in[k], &out[2 * k], &out[2 * k + 1]);
        }}
        if (fwrite(out, 2U * sizeof out[0], n, stdout) != n) {{
            return 2;
        }}
    }}
    return 0;
}}
"""


def has_fma() -> bool:
    return "fma" in Path("/proc/cpuinfo").read_text().split()


def builds(folder: Path, solution: Solution) -> list[Path]:
    """The emitted header compiled without contraction and, where the processor can, with fused multiply-add."""
    reference = solution.fit.reference
    kind, suffix = "float", ""
    if isinstance(reference, FixedReference):
        kind, suffix = f"int{reference.width}_t", f"_{reference.format}"
    for name, content in header_files(solution).items():
        (folder / name).write_bytes(content)
    (folder / "main.c").write_text(MAIN.format(input=kind, suffix=suffix))
    flags = [["-std=c99", "-ffp-contract=off"]]
    if has_fma() and isinstance(reference, CurrentReference):
        flags.append(["-std=c99", "-mfma", "-ffp-contract=fast"])
    programs = []
    for index, more in enumerate(flags):
        program = folder / f"main{index}"
        command = ["gcc", "-O2", *more, "-o", str(program), str(folder / "main.c"), "-lm"]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        programs.append(program)
    return programs


def inputs(reference: CurrentReference | FixedReference) -> Iterator[NDArray[Any]]:
    """Inputs in chunks: both signs, over the domain, log-spaced, and 1000 neighbours of every breakpoint and end."""
    generator = np.random.default_rng(11)
    if isinstance(reference, FixedReference):
        last = reference.end
        if reference.width <= 16:
            yield np.arange(-(2**15), 2**15).astype(np.int16)
            return
        near = (edges_of(reference)[:, np.newaxis] + np.arange(-1000, 1001)).ravel()
        yield np.clip(np.concatenate([near, -near]), -last, last).astype(np.int32)
        for _ in range(INPUTS // CHUNK):
            low = np.exp(generator.uniform(0.0, np.log(last), CHUNK // 4))
            even = generator.uniform(-last, last, CHUNK - low.size)
            yield np.rint(np.concatenate([low, even])).astype(np.int32)
        return
    end = float(reference.torque_max)
    near = neighbours(np.concatenate([edges_of(reference), np.zeros(1, np.float32)]), 1000)
    yield np.clip(np.concatenate([near, -near]), -np.float32(end), np.float32(end))
    for _ in range(INPUTS // CHUNK):
        low = end * np.exp(generator.uniform(np.log(1e-30), 0.0, CHUNK // 4))
        even = generator.uniform(-end, end, CHUNK - low.size)
        yield np.clip(np.concatenate([low, even]).astype(np.float32), -np.float32(end), np.float32(end))


def run(program: Path, given: NDArray[Any]) -> NDArray[Any]:
    done = subprocess.run([program], input=given.tobytes(), capture_output=True, check=True, timeout=60)
    return np.frombuffer(done.stdout, dtype=given.dtype).reshape(-1, 2)


class Check:
    """What the proven bounds are held against: the closed form in double."""

    def __init__(self, solution: Solution) -> None:
        machine, certificate = solution.design.machine, solution.certificate
        assert isinstance(machine, LinearMachine)
        assert certificate is not None
        self.machine, self.bounds, self.reference = machine, certificate, solution.fit.reference
        self.closest = dict.fromkeys(("i_d", "i_q", "torque", "loss", "loss_relative"), 0.0)

    def units(self, codes: NDArray[Any], *, torque: bool) -> FloatArray:
        if isinstance(self.reference, CurrentReference):
            return codes.astype(np.float64)
        scale = self.reference.scale
        return np.asarray(codes * ((scale.argument if torque else scale.result) / scale.one), dtype=np.float64)

    def _hold(self, name: str, error: FloatArray, noise: FloatArray | float) -> None:
        bound = getattr(self.bounds, name)
        assert bound is not None
        room = np.asarray(error - noise)
        assert np.all(room <= bound), (name, float(np.max(room)), bound)
        self.closest[name] = max(self.closest[name], float(np.max(error)) / max(bound, 1e-300))

    def hold(self, request: FloatArray, exact: tuple[FloatArray, FloatArray], currents: NDArray[Any]) -> None:
        """Assert all bounds at torques in N m with their exact currents and those that came out of the program."""
        i_d, i_q = self.units(currents[:, 0], torque=False), self.units(currents[:, 1], torque=False)
        size = np.hypot(*exact)
        self._hold("i_d", np.abs(i_d - exact[0]), ROUNDING * size)
        self._hold("i_q", np.abs(i_q - exact[1]), ROUNDING * size)
        produced = self.machine.torque(i_d, i_q)
        self._hold("torque", np.abs(produced - request), ROUNDING * np.abs(request))
        least_d, least_q = mtpa_currents(self.machine, produced)
        least = least_d * least_d + least_q * least_q
        more = i_d * i_d + i_q * i_q - least
        scale = 1.5 * self.machine.r_s
        self._hold("loss", scale * np.abs(more), scale * ROUNDING * least)
        loaded = np.abs(request) >= PENALTY_FROM * float(self.reference.torque_max)
        self._hold("loss_relative", np.abs(more[loaded]) / least[loaded], ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_no_input_of_the_compiled_header_leaves_the_bounds(name: str, tmp_path: Path) -> None:
    machine, fit = CASES[name]
    solution = solve(make_design(machine, fit=fit))
    reference, check, seen = solution.fit.reference, Check(solution), 0
    programs = builds(tmp_path, solution)
    for given in inputs(reference):
        clamped = np.clip(given, -reference.end, reference.end) if isinstance(reference, FixedReference) else given
        request = check.units(clamped, torque=True)
        exact = mtpa_currents(check.machine, request)
        before: NDArray[Any] | None = None
        for program in programs:
            found = run(program, given)
            # What the second build has in common with the first one has been looked at.
            new = np.ones(len(found), dtype=np.bool_) if before is None else np.any(found != before, axis=1)
            if new.any():
                check.hold(request[new], (exact[0][new], exact[1][new]), found[new])
            before = found
        seen += given.size
    assert seen >= (2**16 if name == "q15" else INPUTS)
    assert isinstance(check.bounds, Certificate)
    # So close that a bound 30 % lower would be found out (where rounding is all there is, one eight times lower).
    assert check.closest["i_q"] > (0.1 if name in ("proportional", "square-root") else 0.7)
    assert check.closest["torque"] > (0.1 if name in ("proportional", "square-root", "torque-exact") else 0.7)
