"""What each form costs on emulated cores beside what it errs by, in one run,
against tables and a bare square root.

All rows have the same signature and treat sign, clamping and not-a-number alike. The table is
printed; what is asserted follows from instructions, bytes and estimated cycles, none of which
depends on the machine that measures.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from drives import IPM, in_floats, make_design

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.names import BreakpointMode, Core, FitForm, NumberFormat, Strategy
from dqforge.optimizer.current_reference.fit import estimated_cycles
from dqforge.optimizer.current_reference.forms import (
    PENALTY_FROM,
    ErrorCurves,
    FixedReference,
    error_curves,
)
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.solution import solve
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.current_reference.plain import vector_torques
from dqforge.reports.main_header import header_files
from dqforge.reports.verification.measured_cost import TargetCost, cost_on_target

pytestmark = pytest.mark.benchmark

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
CORES: tuple[Core, ...] = ("cortex-m4", "cortex-m33", "cortex-m7", "cortex-m0plus")
END = 200.0
CHOICE = CurrentChoice(IPM, "mtpa", IPM.i_max)
FORMS: list[tuple[FitForm, int, int, BreakpointMode]] = [
    ("polynomial", 2, 2, "shared"),
    ("polynomial", 2, 2, "own"),
    ("polynomial", 3, 2, "shared"),
    ("polynomial", 3, 2, "own"),
    ("polynomial", 4, 2, "shared"),
    ("polynomial", 4, 2, "own"),
    ("even-odd", 3, 1, "shared"),
    ("even-odd", 4, 1, "shared"),
    ("even-odd", 2, 2, "shared"),
    ("torque-exact", 2, 1, "shared"),
    ("torque-exact", 2, 2, "shared"),
    ("torque-exact", 4, 2, "shared"),
    ("closed-form", 3, 2, "shared"),
]


class Evaluator(Protocol):
    """Anything that gives the currents of float32 torques in the arithmetic of its C."""

    def currents(
        self, torque: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]: ...


@dataclass(frozen=True)
class Table:
    """NumPy model of tests/firmware/table.h with ``count`` points through exact currents."""

    count: int

    @property
    def values(self) -> tuple[SingleArray, SingleArray]:
        i_d, i_q = CHOICE.currents(np.linspace(0.0, END, self.count))
        return i_d.astype(np.float32), i_q.astype(np.float32)

    @property
    def points_per_nm(self) -> np.float32:
        return np.float32((self.count - 1) / END)

    def source(self) -> bytes:
        i_d, i_q = (
            ", ".join(float_literal(float(value)) for value in table) for table in self.values
        )
        words = {
            "COUNT": str(self.count),
            "VALUES_D": i_d,
            "VALUES_Q": i_q,
            "TORQUE_MAX": float_literal(END),
            "POINTS_PER_NM": float_literal(float(self.points_per_nm)),
            "LAST": f"{self.count - 2}U",
            "END_D": i_d.split(", ")[-1],
            "END_Q": i_q.split(", ")[-1],
        }
        return filled("table.h", words)

    def currents(
        self, torque: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        assert not fused
        magnitude = np.minimum(
            np.where(np.isnan(torque), np.float32(0.0), np.abs(torque)), np.float32(END)
        )
        place = magnitude * self.points_per_nm
        k = np.minimum(place.astype(np.int64), self.count - 2)
        x = place - k.astype(np.float32)
        i_d, i_q = ((table[k + 1] - table[k]) * x + table[k] for table in self.values)
        beyond = np.abs(torque) > END
        i_d, i_q = (
            np.where(beyond, table[-1], inside)
            for table, inside in zip(self.values, (i_d, i_q), strict=True)
        )
        return i_d, np.where(torque < 0.0, -i_q, i_q)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Errors are shares of full scale, None where the argument is no torque.
    """

    label: str
    is_product: bool
    costs: dict[str, TargetCost]
    current: float
    torque: float | None
    loss: float | None

    @property
    def m4(self) -> TargetCost:
        return self.costs["cortex-m4"]

    def line(self) -> str:
        cells = [self.label]
        for cost in self.costs.values():
            low, high = cost.cycles
            cells += [f"{cost.instructions:.1f}", f"{low:.0f}-{high:.0f}", str(cost.flash)]
        shares = (self.current, self.torque, self.loss)
        cells += ["-" if share is None else f"{100.0 * share:.2g}" for share in shares]
        return f"| {' | '.join(cells)} |"


def filled(name: str, words: dict[str, str]) -> bytes:
    text = (FIRMWARE / name).read_text(encoding="ascii")
    comment, code = text.split("*/\n", 1)
    for word, value in words.items():
        code = code.replace(word, value)
    return f"{comment}*/\n{code}".encode("ascii")


def errors_of(evaluator: Evaluator) -> tuple[float, float, float]:
    """Largest error of a current over the full current, of the torque over the full one,
    and the loss penalty.
    """
    torque = np.linspace(0.0, END, 8001, dtype=np.float32)
    curves: ErrorCurves = error_curves(CHOICE, evaluator, torque)  # type: ignore[arg-type]
    full = float(np.hypot(*CHOICE.currents(np.array([END]))).item())
    loaded = torque >= PENALTY_FROM * END
    current = max(float(np.max(np.abs(curves.i_d))), float(np.max(np.abs(curves.i_q))))
    return (
        current / full,
        float(np.max(np.abs(curves.torque_error))) / END,
        float(np.max(curves.loss_relative[loaded])),
    )


def costs_of(sources: dict[str, bytes], name: str, torque: SingleArray) -> dict[str, TargetCost]:
    return {
        core: cost_on_target(sources, f"{name}.h", f"{name}_current_reference", core, torque)
        for core in CORES
    }


@cache
def vectors() -> SingleArray:
    """The torques that every row is run on: special values, both signs, random ones."""
    return vector_torques(
        in_floats(solve(make_design(IPM, fit=FitSettings(degree=2, torque_max=END))).fit), 256
    )


def product_row(label: str, strategy: Strategy, fit: FitSettings) -> Row:
    machine = (
        replace(IPM, i_max=330.0) if strategy == "id0" else IPM
    )  # which i_d = 0 needs for this torque
    solution = solve(make_design(machine, strategy=strategy, fit=fit))
    reference = in_floats(solution.fit)
    costs = costs_of(header_files(solution), "drive", vectors())
    return Row(label, True, costs, *errors_of(reference))


def fixed_row(number_format: NumberFormat, degree: int) -> Row:
    """Polynomials in fixed point, costed at the codes of the same torques."""
    fit = FitSettings(form="polynomial", degree=degree, format=number_format, torque_max=END)
    solution = solve(make_design(IPM, fit=fit))
    reference = solution.fit.reference
    assert isinstance(reference, FixedReference)
    codes = reference.nearest(vectors()).astype(f"i{reference.width // 8}")
    name, sources = f"drive_current_reference_{number_format}", header_files(solution)
    costs: dict[str, TargetCost] = {
        core: cost_on_target(sources, "drive.h", name, core, codes) for core in CORES
    }
    for cost in costs.values():
        np.testing.assert_array_equal(
            cost.currents, np.stack(reference.codes(codes.astype(np.int64)), axis=1)
        )
    errors, full = solution.fit.errors, float(np.hypot(*CHOICE.currents(np.array([END]))).item())
    current = max(errors.i_d, errors.i_q) / full
    label = f"{number_format}, polynomial {degree}, 2 segments"
    return Row(label, True, costs, current, errors.torque / END, errors.loss_relative)


def table_row(count: int) -> Row:
    table = Table(count)
    costs = costs_of({"table.h": table.source()}, "table", vectors())
    model = np.stack(table.currents(vectors()), axis=1)
    for cost in costs.values():
        np.testing.assert_array_equal(cost.currents, model)
    return Row(f"table, {count} points", False, costs, *errors_of(table))


def root_row() -> Row:
    """i_d from i_q.

    Asked for up to the i_q of full torque, so that its cost is over the same share of the domain.
    """
    base = np.float32(IPM.psi_pm / (2.0 * (IPM.l_q - IPM.l_d)))
    _, largest = CHOICE.currents(np.array([END]))
    end = np.float32(largest[0])
    words = {"CURRENT_MAX": float(end), "BASE": float(base), "SQUARED": float(base * base)}
    asked = (vectors() * (end / np.float32(END))).astype(np.float32)
    costs = costs_of(
        {"root.h": filled("root.h", {k: float_literal(v) for k, v in words.items()})}, "root", asked
    )
    inside = np.where(np.isnan(asked), np.float32(0.0), np.clip(asked, -end, end))
    root = base - np.sqrt(inside * inside + base * base)
    for cost in costs.values():
        np.testing.assert_array_equal(cost.currents, np.stack([root, inside], axis=1))
    exact = float(base) - np.hypot(float(base), inside.astype(np.float64))
    current = float(np.max(np.abs(root - exact))) / float(np.hypot(exact.min(), float(end)))
    return Row("i_d from i_q by one root", False, costs, current, None, None)


def all_rows() -> list[Row]:
    rows = [product_row("i_d = 0", "id0", FitSettings(torque_max=END)), root_row()]
    flat = FitSettings(form="torque-exact", degree=3, segments=1, flat_at_zero=True, torque_max=END)
    rows.append(product_row("torque-exact 3, 1 segment, flat at zero", "mtpa", flat))
    for form, degree, segments, mode in FORMS:
        fit = FitSettings(
            form=form, degree=degree, segments=segments, breakpoint_mode=mode, torque_max=END
        )
        shape = (
            "1 segment"
            if segments == 1
            else f"{segments} segments{', own' if mode == 'own' else ''}"
        )
        rows.append(product_row(f"{form} {degree}, {shape}", "mtpa", fit))
    rows += [fixed_row("q15", degree) for degree in (2, 3, 4)]
    return [*rows, fixed_row("q31", 4), table_row(21), table_row(64)]


def test_forms_on_cores(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    rows = all_rows()
    cores = [f"{core[7:].upper()} instructions | cycles | bytes" for core in CORES]
    head = f"| form | {' | '.join(cores)} | current % | torque % | loss % |"
    with capsys.disabled():
        print(
            "", head, f"|{'---|' * (head.count('|') - 1)}", *(row.line() for row in rows), sep="\n"
        )

    by_label = {row.label: row for row in rows}
    counts = [by_label[f"polynomial {degree}, 2 segments"].m4.instructions for degree in (2, 3, 4)]
    assert by_label["i_d = 0"].m4.instructions < counts[0] < counts[1] < counts[2]
    for row in rows:
        assert row.costs["cortex-m0plus"].instructions > row.m4.instructions
        own = by_label.get(f"{row.label}, own")
        assert own is None or own.m4.instructions > row.m4.instructions

    for form, degree, segments, mode in FORMS:
        if mode == "shared":
            low, high = by_label[
                f"{form} {degree}, {segments} segment{'s' if segments > 1 else ''}"
            ].m4.cycles
            assert abs(estimated_cycles(form, degree, segments) - 0.5 * (low + high)) <= 2.5

    formats: list[tuple[NumberFormat, int]] = [("q15", 2), ("q15", 3), ("q15", 4), ("q31", 4)]
    for number_format, degree in formats:
        costs = by_label[f"{number_format}, polynomial {degree}, 2 segments"].costs
        for core in CORES:
            estimate = estimated_cycles("polynomial", degree, 2, number_format, core)
            assert estimate == pytest.approx(0.5 * sum(costs[core].cycles), rel=0.12)
    # What fixed point is for: a core without floating point does it more than ten times as quickly.
    soft, fixed = (
        by_label[f"{name}polynomial 4, 2 segments"].costs["cortex-m0plus"] for name in ("", "q15, ")
    )
    assert fixed.instructions < 0.1 * soft.instructions

    product = [row for row in rows if row.is_product]
    small = [
        row
        for row in product
        if row.torque is not None and row.torque < 1e-3 and (row.loss or 0.0) < 1e-3
    ]
    assert min(row.m4.cycles[1] for row in small) <= 36.0
    table = by_label["table, 64 points"]
    better = [
        row
        for row in product
        if row.m4.cycles[0] <= table.m4.cycles[0]
        and row.m4.cycles[1] <= table.m4.cycles[1]
        and row.torque is not None
        and table.torque is not None
        and row.torque < table.torque
        and row.m4.flash <= table.m4.flash / 4
        and (row.loss or 0.0) < 1e-3
    ]
    assert better, (
        "no form is as quick as the table of 64 points, more exact in torque and a quarter of its "
        "size"
    )
