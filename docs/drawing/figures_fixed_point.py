"""Figure of docs/methods/current-reference.md: what 16 bits cost."""

from __future__ import annotations

from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.names import NumberFormat
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.forms import error_curves
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.reports.pages.figures_style import BLUE, FAINT, ORANGE, new_figure, save, style


@style()
def sixteen_bits(path: Path) -> None:
    """Draw the errors of both currents in single precision and in Q15 at all its torques, degree 4,
    as an SVG.
    """
    choice = current_choice(catalogue.load("paper000-ipmsm-100kw"))
    figure = new_figure(
        "fixed-point", 3.2, "Errors of both currents in Q15 and single precision", arranged=True
    )
    axes = dict(zip(("i_d", "i_q"), figure.subplots(1, 2, sharex=True), strict=True))
    formats: tuple[tuple[NumberFormat, str], ...] = (("q15", ORANGE), ("float32", BLUE))
    for number_format, colour in formats:
        settings = FitSettings(
            form="polynomial", format=number_format, torque_max=200.0, full_scale=(240.0, 283.0)
        )
        reference = fit_reference(choice, settings).reference
        torque = reference.samples(4000)[::6]
        curves = error_curves(choice, reference, torque)
        for name, panel in axes.items():
            panel.plot(
                torque,
                1e3 * getattr(curves, name),
                color=colour,
                linewidth=0.6,
                label=number_format,
            )
    code = 1e3 * 283.0 / 2**15
    for name, panel in axes.items():
        panel.axhspan(
            -0.5 * code, 0.5 * code, color=FAINT, alpha=0.5, label="half a code", zorder=0
        )
        panel.set(xlabel="Torque in N m", ylabel=f"${name}$ error in mA", xlim=(0.0, 200.0))
    figure.legend(*axes["i_d"].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save(figure, path)


if __name__ == "__main__":
    sixteen_bits(Path(__file__).resolve().parents[1] / "figures" / "fixed-point.svg")
