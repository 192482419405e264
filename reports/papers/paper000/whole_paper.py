"""Everything of paper 000 that can be computed: Tables 1 to 4, Figures 2 to 5, and the printed
polynomials as a header.
"""

from __future__ import annotations

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.papers.paper000.core_costs import CoreCosts, core_costs
from dqforge.reports.papers.paper000.heat import HeatCurve, heat_curves
from dqforge.reports.papers.paper000.ipmsm_tables import (
    DESIGN_NAME,
    Reproduction,
    reproduce_paper,
)
from dqforge.reports.papers.paper000.load_test import LoadTest, load_tests
from dqforge.reports.papers.paper000.printed_polynomial import (
    FIXED_PREFIX,
    PREFIX,
    PrintedPolynomial,
    printed_header,
)
from dqforge.reports.papers.paper000.stated_method import StatedMethod, by_stated_method


@dataclass(frozen=True, slots=True, eq=False)
class WholePaper:
    """All of it; ``load_tests`` and ``heat`` are empty where there is no compiler, which
    ``left_out`` says.
    """

    tables: Reproduction
    stated: StatedMethod
    header: PrintedPolynomial
    costs: CoreCosts
    load_tests: tuple[LoadTest, ...]
    heat: tuple[HeatCurve, ...]
    left_out: str


def reproduce_whole() -> WholePaper:
    """Recompute the paper from the library drive."""
    design = catalogue.load(DESIGN_NAME)
    machine, header = linearised(design.machine), printed_header(design)
    tests: tuple[LoadTest, ...] = ()
    left_out = ""
    try:
        tests = load_tests()
    except VerificationError as error:
        left_out = str(error)
    return WholePaper(
        tables=reproduce_paper(),
        stated=by_stated_method(machine),
        header=header,
        costs=core_costs(machine, header.files | header.fixed, PREFIX, FIXED_PREFIX),
        load_tests=tests,
        heat=heat_curves(design, tests),
        left_out=left_out,
    )
