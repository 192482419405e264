"""Figure of the page on two-dimensional references."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.optimizer.field_weakening.fit import solve_weakening
from dqforge.reports.pages.figures_style import save
from dqforge.reports.single_headers.field_weakening import plot_weakening

_DRIVE, _RPM, _FLASH = "baldor-pmsyrm-5k6", 3600.0, 3000


def weakening_errors(path: Path) -> None:
    """Errors of the references of a saturated machine up to twice its rated speed."""
    design = replace(
        catalogue.load(_DRIVE), weakening=WeakeningSettings(_RPM * math.pi / 30.0, flash=_FLASH)
    )
    fit = solve_weakening(design)
    if fit is None:
        raise AssertionError(_DRIVE)
    save(plot_weakening(fit), path)
