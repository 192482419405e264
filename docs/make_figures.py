"""Draw every figure of the documentation anew; the files are the same bytes every time."""

from __future__ import annotations

from pathlib import Path

import figures_gains
import figures_losses

from dqforge.machines import catalogue
from dqforge.optimizer.solution import solve_curves, solve_fit
from dqforge.reports.figures import plot_fit, plot_mtpa, save


def main() -> None:
    """Write the figures into docs/figures."""
    folder = Path(__file__).resolve().parent / "figures"
    folder.mkdir(exist_ok=True)
    design = catalogue.load("paper000-ipmsm-100kw")
    save(plot_mtpa(design, solve_curves(design)), folder / "mtpa.svg")
    save(plot_fit(design, solve_fit(design)), folder / "fit.svg")
    figures_gains.current_loop_step(folder / "current-loop-step.svg")
    figures_gains.observer_error(folder / "observer-error.svg")
    figures_losses.modulation_waveforms(folder / "modulation-waveforms.svg")
    figures_losses.loss_comparison(folder / "loss-comparison.svg")


if __name__ == "__main__":
    main()
