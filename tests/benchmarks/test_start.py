"""How long a user waits: ratios measured in one run and printed, never asserted (run
with ``-m benchmark -s``).
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_per_unit
from dqforge.reports.papers.paper000_stated_method import table_1
from dqforge.reports.run import run_design

pytestmark = pytest.mark.benchmark


def seconds(command: list[str], repeats: int = 7) -> float:
    """Median wall-clock time of a command."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(command, capture_output=True, check=True)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def test_help_against_importing_numpy() -> None:
    numpy_time = seconds([sys.executable, "-c", "import numpy"])
    help_time = seconds([str(Path(sys.executable).with_name("dqforge")), "--help"])
    print(
        "\n"
        f"dqforge --help: {help_time / numpy_time:.2f} times 'import numpy' ({help_time:.3f} s, "
        f"{numpy_time:.3f} s)"
    )


def test_demo_against_importing_numpy(tmp_path: Path) -> None:
    numpy_time = seconds([sys.executable, "-c", "import numpy"], 3)
    command = [
        str(Path(sys.executable).with_name("dqforge")),
        "run",
        "paper000-ipmsm-100kw",
        "-o",
        str(tmp_path),
    ]
    demo_time = seconds(command, 3)
    print(f"\ndemo: {demo_time:.2f} s, {demo_time / numpy_time:.0f} times 'import numpy'")


def test_breakpoint_search_against_the_rest_of_a_run() -> None:
    start = time.perf_counter()
    table_1()
    search = time.perf_counter() - start
    start = time.perf_counter()
    run_design(catalogue.load("paper000-ipmsm-100kw"), verify=True)
    whole = time.perf_counter() - start
    print(
        f"\nbreakpoints of degree 2, 3 and 4 by search: {search:.2f} s; a whole run: {whole:.2f} s"
    )


def test_minimax_against_cvxpy() -> None:
    """One minimax fit of two joined segments: the linear programme with exchange
    against cvxpy and Clarabel.
    """
    import cvxpy as cp
    from numpy.polynomial import chebyshev

    edges = np.array([0.0, 1.6, 5.0])
    start = time.perf_counter()
    for _ in range(10):
        fit_curve(lambda t: mtpa_per_unit(t)[0], edges, 4, "minimax", SideConditions(True, True))
    ours = (time.perf_counter() - start) / 10
    reference = -np.cos(np.linspace(0.0, np.pi, 300))
    block = chebyshev.chebvander(reference, 4)
    basis = np.block([[block, 0 * block], [0 * block, block]])
    torque = np.concatenate([0.8 * (reference + 1.0), 1.6 + 1.7 * (reference + 1.0)])
    start = time.perf_counter()
    coefficients, level = cp.Variable(10), cp.Variable()
    signs = (-1.0) ** np.arange(5)
    seam = np.concatenate([np.ones(5), -signs])
    constraints = [
        cp.abs(basis @ coefficients - mtpa_per_unit(torque)[0]) <= level,
        seam @ coefficients == 0,
        np.concatenate([signs, np.zeros(5)]) @ coefficients == 0,
    ]
    cp.Problem(cp.Minimize(level), constraints).solve(solver=cp.CLARABEL)
    theirs = time.perf_counter() - start
    print(
        "\n"
        f"minimax fit: {ours * 1e3:.1f} ms; on 300 points per segment with cvxpy: "
        f"{theirs / ours:.1f} times as long"
    )
