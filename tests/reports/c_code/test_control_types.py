"""Shared control types: compiled C against its float32 model bit for bit,
the model against double precision.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.transforms import Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.reports.c_code import harness as model
from dqforge.reports.operating_system.host_compiler import find_compiler
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.host import COMPILERS, WARNINGS, Compiler

HARNESS = """
#include <math.h>
#include <stdio.h>
%s
int main(void)
{
    float x[3];

    while (fread(x, sizeof x, 1U, stdin) == 1U) {
        float y[12];
        t_abc_t phases = { x[0], x[1], x[2] };
        t_rotation_t turn = t_rotation(t_wrap(x[0]));
        t_alphabeta_t fixed = t_clarke(phases);
        t_dq_t dq = t_park(fixed, turn);
        t_alphabeta_t back = t_park_inverse(dq, turn);
        t_abc_t again = t_clarke_inverse(back);

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
    return np.concatenate([angles[:, None], rest], axis=1)


def _model(x: SingleArray) -> SingleArray:
    a, b, c = (np.ascontiguousarray(column) for column in x.T)
    with np.errstate(
        invalid="ignore"
    ):  # angles beside the range are not-a-number or infinite on purpose
        angle = model.wrap(a)
        turn = model.rotation(angle)
        vector = clarke(model.SINGLE, Triple(a, b, c))
        turned = park(model.SINGLE, vector, turn)
        back = park_inverse(model.SINGLE, turned, turn)
        return np.stack(
            [angle, *turn, *vector, *turned, *back, *clarke_inverse(model.SINGLE, back)], axis=1
        )


@pytest.mark.parametrize("compiler", COMPILERS, ids=lambda compiler: compiler.standard)
def test_compiled_functions_equal_the_model_bit_for_bit(compiler: Compiler, tmp_path: Path) -> None:
    there = find_compiler(compiler.language)
    if there is None:
        pytest.skip(f"no compiler of {compiler.language}")
    partial = render("c_code/control_types.j2", {"prefix": "t", "macro": "T"})
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
    compiled = np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 12)
    expected = _model(inputs)
    unlike = compiled.view(np.uint32) != expected.view(np.uint32)
    unlike &= ~(
        np.isnan(compiled) & np.isnan(expected)
    )  # the sign of not-a-number is nobody's business
    assert not unlike.any(), (inputs[unlike.any(axis=1)][:3], compiled[unlike.any(axis=1)][:3])


def test_rotation_is_within_its_stated_error() -> None:
    theta = np.linspace(-model.PI, model.PI, 2_000_001).astype(np.float32)
    cosine, sine = model.rotation(theta)
    exact = theta.astype(np.float64)
    assert np.max(np.abs(cosine - np.cos(exact))) < 1.2e-7
    assert np.max(np.abs(sine - np.sin(exact))) < 1.2e-7
    assert cosine.dtype == sine.dtype == np.float32


def test_wrap_keeps_the_angle_and_the_range() -> None:
    theta = np.random.default_rng(4).uniform(-60_000.0, 60_000.0, 100_000).astype(np.float32)
    angle = model.wrap(theta)
    assert np.all((angle >= -model.PI) & (angle < model.PI))
    away = (angle.astype(np.float64) - theta.astype(np.float64) + np.pi) % (2.0 * np.pi) - np.pi
    assert np.max(np.abs(away)) < 2e-5  # n times the rounding of the second part of 2 pi
    inside = theta / np.float32(60_000.0)
    np.testing.assert_array_equal(model.wrap(inside), inside)


def test_transformations_are_those_of_the_definition() -> None:
    theta = np.linspace(-3.0, 3.0, 41)
    a, b, c = (
        7.0 * np.cos(theta - k * 2.0 * np.pi / 3.0) + 2.0 for k in range(3)
    )  # with a zero sequence
    alpha, beta = clarke(model.SINGLE, Triple(*(x.astype(np.float32) for x in (a, b, c))))
    np.testing.assert_allclose(alpha, 7.0 * np.cos(theta), atol=3e-6)
    np.testing.assert_allclose(beta, 7.0 * np.sin(theta), atol=3e-6)
    turn = model.rotation(theta.astype(np.float32))
    d, q = park(model.SINGLE, (alpha, beta), turn)
    np.testing.assert_allclose(d, 7.0, atol=5e-6)
    np.testing.assert_allclose(q, 0.0, atol=5e-6)
    again = clarke_inverse(model.SINGLE, park_inverse(model.SINGLE, (d, q), turn))
    np.testing.assert_allclose(np.stack(again), np.stack([a, b, c]) - 2.0, atol=1e-5)
