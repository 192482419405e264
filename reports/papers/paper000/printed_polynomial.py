"""The printed polynomials of paper 000 as a header of ours: breakpoints per axis, 0 to 5 per unit,
with the printed coefficients, verified by execution and compared with the exact MTPA.

The emitted form evaluates each segment from its start. The powers of the torque itself, which the
paper prints, become those of the distance by a shift that changes no value.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.forms import (
    CurrentReference,
    Polynomials,
    error_curves,
    reference_errors,
)
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.operating_points.mtpa import mtpa_currents, per_unit_base
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header.header import header_files
from dqforge.reports.operating_system.host_compiler import NO_COMPILER, find_compiler
from dqforge.reports.papers.paper000.ipmsm_tables import PRINTED_TABLE_2
from dqforge.reports.papers.paper000.stated_method import CURVE_END, DOMAIN, edges_of
from dqforge.reports.verification.host import verify_files

PREFIX = "paper000_mtpa"
FIXED_PREFIX = "paper000_q15"
DEGREE = 4  # The degree that the paper recommends and drives its machine with.
_VECTORS = 256
_SAMPLES = 25_001


@dataclass(frozen=True, slots=True)
class AxisErrors:
    """Errors of an axis in A of the float32 code against the exact MTPA: r.m.s. and largest up to
    250 N m, largest up to 5 per unit.
    """

    axis: str
    rms: float
    largest: float
    largest_in_domain: float


@dataclass(frozen=True, slots=True, eq=False)
class PrintedPolynomial:
    """The header with what it errs by.

    ``torque_max`` in N m is 5 per unit; ``breakpoints`` in N m are those of d and q; ``compared``
    results equalled the model bit for bit, 0 where no compiler is there, which ``missing`` says.
    ``fixed`` are the files of a reference of the same degree in Q15, with coefficients of ours, for
    what it costs.
    """

    degree: int
    torque_max: float
    breakpoints: tuple[float, float]
    errors: tuple[AxisErrors, ...]
    compared: int
    missing: str
    files: dict[str, bytes]
    fixed: dict[str, bytes]


def printed_piecewise(axis: str, degree: int, machine: LinearMachine) -> PiecewisePolynomial:
    """Printed coefficients of an axis, from the start of each segment, in A over N m."""
    edges = edges_of(axis, degree) * per_unit_base(machine).torque
    rows = []
    for start, printed in zip(edges[:-1].tolist(), PRINTED_TABLE_2[axis, degree], strict=True):
        shifted = np.polynomial.Polynomial(printed[::-1])(np.polynomial.Polynomial([start, 1.0]))
        row = np.zeros(degree + 1)
        row[: shifted.coef.size] = shifted.coef
        rows.append(row)
    return PiecewisePolynomial(edges, np.array(rows))


def _rounded(found: PiecewisePolynomial) -> SinglePolynomial:
    """Each coefficient rounded for itself, so that the first segment keeps the printed ones."""
    return SinglePolynomial(
        found.edges[:-1].astype(np.float32), found.coefficients.astype(np.float32)
    )


def _with_printed(solution: Solution, degree: int) -> Solution:
    """The solution with the printed polynomials as its current reference."""
    machine = linearised(solution.design.machine)
    d, q = (printed_piecewise(axis, degree, machine) for axis in "dq")
    end = float(d.edges[-1])
    form = Polynomials(_rounded(d), _rounded(q))
    reference = CurrentReference(form, np.float32(end))
    choice = current_choice(solution.design)
    fit = replace(
        solution.fit,
        settings=replace(solution.fit.settings, method="lagrange", degree=degree),
        form="polynomial",
        torque_max=end,
        d=d,
        q=q,
        reference=reference,
        errors=reference_errors(choice, reference),
        curves=error_curves(choice, reference, reference.samples(400)),
    )
    return replace(solution, fit=fit, certificate=None, alternatives=(), trials=())


def _in_q15(solution: Solution) -> dict[str, bytes]:
    """Header and vectors of a reference of the same degree in Q15, fitted to the limits of the
    drive.
    """
    design = solution.design
    settings = replace(
        design.fit,
        form="polynomial",
        degree=DEGREE,
        format="q15",
        full_scale=(CURVE_END, design.i_max),
    )
    export = replace(design.export, prefix=FIXED_PREFIX)
    fitted = replace(
        solution,
        design=replace(design, fit=settings, export=export),
        fit=fit_reference(current_choice(design), settings),
        certificate=None,
    )
    return header_files(fitted)


def _errors(reference: CurrentReference, machine: LinearMachine) -> tuple[AxisErrors, ...]:
    torque = np.linspace(0.0, float(reference.torque_max), _SAMPLES)
    exact, found = mtpa_currents(machine, torque), reference.currents(torque)
    inside = torque <= CURVE_END
    rows = []
    for axis, value, right in zip("dq", found, exact, strict=True):
        error = np.abs(value.astype(np.float64) - right)
        rms = float(np.sqrt(np.mean(error[inside] ** 2)))
        rows.append(AxisErrors(axis, rms, float(np.max(error[inside])), float(np.max(error))))
    return tuple(rows)


def printed_header(design: Design) -> PrintedPolynomial:
    """Emit, run and judge the header of the printed polynomials of degree 4.

    Raises:
        VerificationError: The compiled header differs from its model.
    """
    export = replace(design.export, prefix=PREFIX, vectors=_VECTORS)
    # What the header holds beside the currents is not asked for here.
    plain = replace(
        design,
        name=f"{design.name}, printed polynomials of degree {DEGREE}",
        export=export,
        losses=None,
        modulation_choice=None,
        weakening=None,
    )
    solved = solve(plain)
    solution = _with_printed(solved, DEGREE)
    reference = solution.fit.reference
    assert isinstance(reference, CurrentReference)
    files, compared, missing = header_files(solution), 0, ""
    if find_compiler() is None:
        missing = f"{NO_COMPILER}."
    else:
        found = verify_files(files, PREFIX, reference, _VECTORS)
        compared = sum(check.compared for check in found.checks)
    machine = linearised(design.machine)
    breakpoints = tuple(float(edges_of(axis, DEGREE)[1]) for axis in "dq")
    base = per_unit_base(machine).torque
    return PrintedPolynomial(
        degree=DEGREE,
        torque_max=DOMAIN * base,
        breakpoints=(breakpoints[0] * base, breakpoints[1] * base),
        errors=_errors(reference, machine),
        compared=compared,
        missing=missing,
        files=files,
        fixed=_in_q15(solved),
    )
