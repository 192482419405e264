"""The documentation's figure of a saturated machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
)

_COLOURS = (BLUE, TEAL, ORANGE)


def flux_map(path: Path) -> None:
    """Flux linkages of the Baldor machine over one current for three values of the other,
    and the inductances.
    """
    design = catalogue.load("baldor-pmsyrm-5k6")
    machine, i_max = design.machine, design.i_max
    current = np.linspace(-i_max, i_max, 241)
    with style():
        figure = new_figure(
            "flux-map", 3.2, "Flux linkages over the currents, and incremental inductances"
        )
        left, middle, right = (figure.add_axes((x, 0.15, 0.25, 0.74)) for x in (0.075, 0.4, 0.735))
        for share, colour in zip((0.0, 0.5, 1.0), _COLOURS, strict=True):
            other = np.full_like(current, share * i_max)
            along_d, along_q = machine.jet(current, other), machine.jet(-other, current)
            label, sign = f"{share * i_max:.3g} A", "\u2212" if share > 0.0 else ""
            left.plot(current, along_d.psi_d, color=colour, label=f"$i_q$ = {label}")
            middle.plot(
                current,
                along_q.psi_q,
                color=colour,
                label=f"$i_d$ = {sign}{label}",
            )
            right.plot(
                -current, along_d.l_dd * 1e3, color=colour, label=f"$L_{{dd}}$, $i_q$ = {label}"
            )
        at_rest = machine.jet(np.zeros_like(current), current)
        right.plot(
            current, at_rest.l_qq * 1e3, color=INK, linestyle="dashed", label="$L_{qq}$, $i_d$ = 0"
        )
        for axes in (left, middle):
            axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
        left.set(xlabel="$i_d$ in A", ylabel="$\u03c8_d$ in Wb", title="d axis")
        middle.set(xlabel="$i_q$ in A", ylabel="$\u03c8_q$ in Wb", title="q axis")
        right.set(
            xlabel="\u2212$i_d$ of $L_{dd}$, $i_q$ of $L_{qq}$ in A",
            ylabel="Inductance in mH",
            title="Incremental",
            xlim=(0.0, i_max),
            ylim=(0.0, None),
        )
        for axes in (left, middle, right):
            axes.legend(fontsize=6.5, loc="best")
    save(figure, path)
