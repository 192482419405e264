"""Errors of the emitted sine and cosine: of every float from 2^-12 to pi and of both signs, as the
header has them compiled with and without fused multiply-add, and of the angle turned on.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dqforge.reports.c_code import harness as model
from dqforge.reports.steps.control_types import control_types

# Largest errors of rotation(theta), of small_rotation(theta) within 0.4 rad, and of a random pair
# of both, in double precision.
PROGRAMME = """
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
%s
static double worst(double before, t_rotation_t turn, double angle)
{
    const double cosine = fabs((double)turn.cosine - cos(angle));
    const double sine = fabs((double)turn.sine - sin(angle));

    before = (cosine > before) ? cosine : before;
    return (sine > before) ? sine : before;
}

static float drawn(uint64_t *state, float most)
{
    *state = (*state * 6364136223846793005U) + 1442695040888963407U;
    return most * (float)((double)(int64_t)*state / 9223372036854775808.0);
}

int main(int argc, char **argv)
{
    const uint32_t step = (uint32_t)strtoul(argv[1], NULL, 10);
    const long pairs = strtol(argv[2], NULL, 10);
    double whole = 0.0;
    double small = 0.0;
    double both = 0.0;
    uint64_t state = 20261122U;
    uint32_t bits;
    long k;

    (void)argc;
    for (bits = 0x39800000U; bits <= 0x40490fdbU; bits += step) { /* 2^-12 to the float above pi */
        float theta;

        memcpy(&theta, &bits, sizeof theta);
        whole = worst(whole, t_rotation(theta), (double)theta);
        whole = worst(whole, t_rotation(-theta), -(double)theta);
        if (theta <= 0.4F) {
            small = worst(small, t_small_rotation(theta), (double)theta);
            small = worst(small, t_small_rotation(-theta), -(double)theta);
        }
    }
    for (k = 0; k < pairs; ++k) {
        const float theta = drawn(&state, 3.1415927F);
        const float ahead = drawn(&state, 0.4F);
        const t_rotation_t turn = t_turned(t_rotation(theta), t_small_rotation(ahead));

        both = worst(both, turn, (double)theta + (double)ahead);
    }
    printf("%%.9g %%.9g %%.9g\\n", whole, small, both);
    return 0;
}
"""

MODES = [
    pytest.param(("-ffp-contract=off",), id="separate"),
    pytest.param(("-ffp-contract=fast", "-mfma"), id="fused"),
]


def largest_errors(
    flags: tuple[str, ...], folder: Path, step: str, pairs: str, compiler: str = "gcc"
) -> list[float]:
    """Largest errors of the whole angle, of the small one and of both together.

    ``step`` is that of the floats' bits, ``pairs`` the number of random pairs.
    """
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    if "-mfma" in flags and "fma" not in Path("/proc/cpuinfo").read_text(encoding="utf-8"):
        pytest.skip("this processor has no fused multiply-add")
    types = control_types("t", "T")
    (folder / "errors.c").write_text(PROGRAMME % types, encoding="ascii")
    command = [compiler, "-std=c99", "-O2", *flags, "errors.c", "-o", "errors", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(
        [folder / "errors", step, pairs], capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


@pytest.mark.parametrize("flags", MODES)
def test_errors_of_a_sample_are_below_those_stated(flags: tuple[str, ...], tmp_path: Path) -> None:
    whole, small, both = largest_errors(flags, tmp_path, "997", "200000")
    assert 0.8e-7 < whole < 1.2e-7
    assert 2e-8 < small < 6e-8
    assert 1e-7 < both < 2e-7


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_freedom_of_the_compiler_spoils_an_angle(compiler: str, tmp_path: Path) -> None:
    """With -ffast-math sums may be taken in any order, as much firmware is compiled."""
    whole, small, both = largest_errors(("-O3", "-ffast-math"), tmp_path, "997", "1000", compiler)
    assert whole < 5e-7
    assert small < 2e-7
    assert both < 6e-7


@pytest.mark.slow
@pytest.mark.parametrize("flags", MODES)
def test_errors_of_every_angle_are_below_those_stated(
    flags: tuple[str, ...], tmp_path: Path
) -> None:
    """From 2^-12 to pi. Below it the cosine lies within 3e-8 of 1 and the sine within 3e-12 of the
    angle, so that one rounding is all that is left of either error.
    """
    whole, small, both = largest_errors(flags, tmp_path, "1", "100000000")
    assert whole < 1.2e-7
    assert small < 6e-8
    assert both < 2e-7


def test_the_small_angle_equals_the_whole_one_where_they_meet() -> None:
    """No jump at 0.4 rad but rounding, and any speed beyond it is right."""
    theta = np.concatenate(
        [np.linspace(-70.0, 70.0, 400_001), np.linspace(0.39, 0.41, 20_001)]
    ).astype(np.float32)
    for one, other in zip(model.small_rotation(theta), model.rotation(theta), strict=True):
        assert np.max(np.abs(one - other)) < 1.5e-7
    with np.errstate(invalid="ignore", over="ignore"):
        bad = np.array([np.nan, np.inf, -np.inf, 1e30, 65536.0], dtype=np.float32)
        for cosine, sine in (model.small_rotation(bad), model.rotation(bad)):
            np.testing.assert_array_equal(cosine, 1.0)
            np.testing.assert_array_equal(sine, 0.0)
