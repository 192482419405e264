"""Figure of the page on comparing designs: what each kind of side is compared by."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from page_text import written_file

from dqforge import emit, load_design
from dqforge.reports.comparison.sides_compared import compare_sides
from dqforge.reports.comparison.sources import Side, firmware_side, read_side
from dqforge.reports.pages.figures_style import BLUE, FAINT, PAPER, new_figure, save, style

_DRIVE = "paper001-pmsm-bench"

_SECTIONS = {
    "machine": ("machine",),
    "limits": ("limits",),
    "current\nreference": ("current reference",),
    "loops": ("i_d loop", "i_q loop", "speed loop"),
    "observer": ("observer",),
    "losses": ("losses",),
    "macros": ("macros",),
}


@style()
def sides(path: Path) -> None:
    """Numbers of rows by section that a side of each kind has with the folder of a run."""
    with TemporaryDirectory() as folder:
        found = {name: _counts(side, other) for name, (side, other) in _pairs(folder).items()}
    figure = new_figure("compared-sides", 2.05, "What each kind of side is compared by")
    axes = figure.add_axes((0.3, 0.03, 0.69, 0.73))
    for row, counts in enumerate(found.values()):
        for column, count in enumerate(counts):
            colour = BLUE if count else FAINT
            axes.plot(column, row, "o", color=colour, markersize=21 if count else 4)
            if count:
                axes.text(
                    column,
                    row,
                    str(count),
                    color=PAPER,
                    fontsize=8.0,
                    fontweight="bold",
                    ha="center",
                    va="center",
                )
    axes.set_yticks(range(len(found)), list(found), fontsize=8.5)
    axes.set_xticks(range(len(_SECTIONS)), list(_SECTIONS), fontsize=8.5)
    axes.tick_params(labelbottom=False, labeltop=True, length=0)
    axes.set(xlim=(-0.6, len(_SECTIONS) - 0.4), ylim=(len(found) - 0.5, -0.5))
    save(figure, path)


def _pairs(folder: str) -> dict[str, tuple[Side, Side]]:
    """Sides of each kind, of one drive; each beside the folder of its run."""
    run, alone = Path(folder) / "out", Path(folder) / "result.json"
    design = load_design(_DRIVE)
    emit(design, run)
    alone.write_bytes((run / "result.json").read_bytes())
    foreign = Path(folder) / "mcconf.h"
    foreign.write_text(written_file("how-to/explain-a-configuration.md", foreign.name), "utf-8")
    folder_side = read_side(str(run), load_design)
    configuration = firmware_side(str(foreign))
    assert configuration is not None
    kinds = {
        "design, folder of a run": folder_side,
        "result.json alone": read_side(str(alone), load_design),
        "header <prefix>.h": read_side(str(run / f"{design.export.prefix}.h"), load_design),
        "other firmware": configuration,
    }
    return {name: (side, folder_side) for name, side in kinds.items()}


def _counts(side: Side, other: Side) -> list[int]:
    found = compare_sides(side, other)
    sections = [row.section for row in found.rows if row.a is not None and row.b is not None]
    sections += ["losses"] * len(found.losses) + ["macros"] * (found.macros_compared or 0)
    return [sum(sections.count(name) for name in names) for names in _SECTIONS.values()]
