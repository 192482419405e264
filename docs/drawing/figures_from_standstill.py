"""Figure of the page on library drives that start from standstill: its settings are drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

import dqforge
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, new_figure, save, style

SETTINGS = Path(__file__).resolve().parents[1] / "methods" / "files" / "from-standstill.yaml"

_RPM = np.pi / 30.0


def settings_of_the_page() -> dict[str, dict[str, Any]]:
    """The file that the page names: settings by the name of the library drive."""
    found: dict[str, dict[str, Any]] = {}
    for name, sections in yaml.safe_load(SETTINGS.read_text(encoding="utf-8")).items():
        found[name] = {
            f"{section}.{key}" if section != "simulation" else section: value
            for section, keys in sections.items()
            for key, value in (keys.items() if section != "simulation" else [("", keys)])
        }
    return found


@style()
def four_starts(path: Path) -> None:
    """Speeds of the four drives, true and estimated."""
    figure = new_figure(
        "from-standstill", 4.4, "Speeds of four drives from standstill", arranged=True
    )
    axes = figure.subplots(2, 2)
    for ax, (name, changes) in zip(axes.flat, settings_of_the_page().items(), strict=True):
        drive = dqforge.simulate(dqforge.load_design(name, changes))
        ax.plot(drive.t, drive.reference / _RPM, color=MUTED, linewidth=0.9, label="reference")
        ax.plot(drive.t, drive.omega_m / _RPM, color=BLUE, label="speed")
        estimate = drive.found.run.omega_m_observed / _RPM
        ax.plot(drive.t, estimate, linewidth=0.7, color=ORANGE, label="estimate")
        ax.set(title=name, xlabel="Time in s", ylabel="Speed in rpm")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save(figure, path)
