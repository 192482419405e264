"""The figures of paper 002 by the names of their files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from dqforge.reports.papers.paper002.recomputed import Reproduction
from dqforge.reports.papers.paper002_definitions.back_emf_components import frame_curves
from dqforge.reports.papers.paper002_definitions.bench_figures import plot_currents, plot_machine
from dqforge.reports.papers.paper002_definitions.control_figures import plot_structures, plot_terms
from dqforge.reports.papers.paper002_definitions.frame_figures import plot_frames
from dqforge.reports.papers.paper002_loops.loop_figures import plot_loops, plot_step

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures_of(found: Reproduction) -> dict[str, Callable[[], Figure]]:
    """Figures by file name, drawn when called; those of the loops where they were run."""
    frames, loops = frame_curves(), found.loops
    drawn: dict[str, Callable[[], Figure]] = {
        "figures-2.3-to-3.2.svg": lambda: plot_frames(frames),
        "figures-4.1-to-4.3.svg": plot_structures,
        "figure-4.3-terms.svg": lambda: plot_terms(found.terms),
        "figures-6.2-to-6.7.svg": lambda: plot_machine(found.curves),
        "figures-6.9-to-6.16.svg": lambda: plot_currents(found.curves),
    }
    if loops is not None:
        drawn["figures-6.9-to-6.16-loops.svg"] = lambda: plot_loops(loops.runs, found.curves)
        drawn["figures-6.17-to-6.18.svg"] = lambda: plot_step(loops.runs)
    return drawn
