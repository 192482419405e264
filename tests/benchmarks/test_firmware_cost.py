"""What each form costs on emulated cores beside what it errs by, in one run; printed, only the order is asserted."""

from __future__ import annotations

import os
import shutil

import pytest
from drives import IPM, make_design

from dqforge.machines.settings import FitForm, FitSettings, Strategy
from dqforge.optimizer.solution import solve
from dqforge.reports.cross import verify_on_target
from dqforge.reports.header import header_files

pytestmark = pytest.mark.benchmark

CASES: list[tuple[str, Strategy, FitForm, int, int]] = [
    ("i_d = 0", "id0", "polynomial", 1, 1),
    ("polynomial, degree 2", "mtpa", "polynomial", 2, 2),
    ("polynomial, degree 3", "mtpa", "polynomial", 3, 2),
    ("polynomial, degree 4", "mtpa", "polynomial", 4, 2),
    ("torque-exact, degree 2", "mtpa", "torque-exact", 2, 2),
    ("torque-exact, degree 4", "mtpa", "torque-exact", 4, 2),
    ("closed-form, degree 3", "mtpa", "closed-form", 3, 2),
]


def test_forms_on_cores(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    lines = ["", "form | M4F instructions | bytes | M0+ instructions | torque error % | loss penalty %"]
    counts = {}
    for label, strategy, form, degree, segments in CASES:
        settings = FitSettings(
            form=form, degree=degree, segments=segments, torque_max=200.0 if strategy == "mtpa" else None
        )
        solution = solve(make_design(IPM, strategy=strategy, fit=settings))
        files, errors = header_files(solution), solution.fit.errors
        m4, m0 = (verify_on_target(files, "drive", core) for core in ("cortex-m4", "cortex-m0plus"))
        counts[label] = m4.instructions
        lines.append(
            f"{label} | {m4.instructions:.1f} | {m4.flash} | {m0.instructions:.0f} | "
            f"{100.0 * errors.torque_relative:.2g} | {100.0 * errors.loss_relative:.2g}"
        )
    with capsys.disabled():
        print("\n".join(lines))
    assert counts["i_d = 0"] < counts["polynomial, degree 2"] < counts["polynomial, degree 4"]
