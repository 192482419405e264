"""Shared control types: compiled C against its float32 model bit for bit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.transforms import Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.reports.c_code.harness import rotation, small_rotation, turned, wrap
from dqforge.reports.operating_system.host_compiler import find_compiler
from dqforge.reports.steps.control_types import control_types
from dqforge.reports.verification.host import COMPILERS, WARNINGS, Compiler

HARNESS = """
#include <math.h>
#include <stdio.h>
%s
int main(void)
{
    float x[3];

    while (fread(x, sizeof x, 1U, stdin) == 1U) {
        float y[16];
        t_abc_t phases = { x[0], x[1], x[2] };
        t_rotation_t turn = t_rotation(t_wrap(x[0]));
        t_alphabeta_t fixed = t_clarke(phases);
        t_dq_t dq = t_park(fixed, turn);
        t_alphabeta_t back = t_park_inverse(dq, turn);
        t_abc_t again = t_clarke_inverse(back);
        t_rotation_t small = t_small_rotation(x[1]);
        t_rotation_t sum = t_turned(turn, small);

        y[0] = t_wrap(x[0]);
        y[1] = turn.cosine;
        y[2] = turn.sine;
        y[3] = fixed.alpha;
        y[4] = fixed.beta;
        y[5] = dq.d;
        y[6] = dq.q;
        y[7] = back.alpha;
        y[8] = back.beta;
        y[9] = again.a;
        y[10] = again.b;
        y[11] = again.c;
        y[12] = small.cosine;
        y[13] = small.sine;
        y[14] = sum.cosine;
        y[15] = sum.sine;
        if (fwrite(y, sizeof y, 1U, stdout) != 1U) {
            return 2;
        }
    }
    return 0;
}
"""


def _inputs() -> SingleArray:
    generator = np.random.default_rng(20261121)
    angles = np.concatenate(
        [
            generator.uniform(-np.pi, np.pi, 40_000),
            generator.uniform(-70_000.0, 70_000.0, 10_000),
            np.arange(-30, 31) * np.pi / 4.0,
            np.nextafter(np.float32(np.pi), [-10.0, 10.0]),
            [0.0, -0.0, np.nan, np.inf, -np.inf, 65536.0, -65536.0, 1e-45],
        ]
    ).astype(np.float32)
    rest = generator.uniform(-50.0, 50.0, (angles.size, 2)).astype(np.float32)
    rest[::3] *= np.float32(0.01)  # angles within 0.4 rad
    return np.concatenate([angles[:, None], rest], axis=1)


def _model(x: SingleArray) -> SingleArray:
    a, b, c = (np.ascontiguousarray(column) for column in x.T)
    with np.errstate(
        invalid="ignore"
    ):  # angles beside the range are not-a-number or infinite on purpose
        angle = wrap(a)
        turn = rotation(angle)
        vector = clarke(SINGLE, Triple(a, b, c))
        seen = park(SINGLE, vector, turn)
        back = park_inverse(SINGLE, seen, turn)
        small = small_rotation(b)
        again = clarke_inverse(SINGLE, back)
        found = [angle, *turn, *vector, *seen, *back, *again, *small, *turned(turn, small)]
        return np.stack(found, axis=1)


@pytest.mark.parametrize("compiler", COMPILERS, ids=lambda compiler: compiler.standard)
def test_compiled_functions_equal_the_model_bit_for_bit(compiler: Compiler, tmp_path: Path) -> None:
    there = find_compiler(compiler.language)
    if there is None:
        pytest.skip(f"no compiler of {compiler.language}")
    partial = control_types("t", "T") + "\n"
    (tmp_path / "harness.c").write_text(
        HARNESS % (partial + partial), encoding="ascii"
    )  # twice: it is guarded
    command = [
        *there.command,
        *there.flags,
        "-x",
        compiler.language,
        f"-std={compiler.standard}",
        "-O2",
        "-ffp-contract=off",
    ]
    subprocess.run([*command, *WARNINGS, "-o", "harness", "harness.c"], cwd=tmp_path, check=True)
    inputs = _inputs()
    done = subprocess.run(
        [tmp_path / "harness"], input=inputs.tobytes(), capture_output=True, check=True
    )
    compiled = np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 16)
    expected = _model(inputs)
    unlike = compiled.view(np.uint32) != expected.view(np.uint32)
    unlike &= ~(
        np.isnan(compiled) & np.isnan(expected)
    )  # the sign of not-a-number is nobody's business
    assert not unlike.any(), (inputs[unlike.any(axis=1)][:3], compiled[unlike.any(axis=1)][:3])
