"""What `dqforge dqy` answers: phase currents of a machine whose back-EMF is not sinusoidal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_option
from dqforge.optimizer.waveforms.comparison import compare_waveforms, with_point
from dqforge.reports.answers.flashing_choice import what_to_flash
from dqforge.reports.flashing_choice import flash_tables, plain_flash
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.plain_data import PlainData
from dqforge.reports.waveforms.tables import plain_waveforms, waveform_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class WaveformRequest:
    """The options as they were written; None where an option was not given."""

    torque: str | None
    speed: str | None
    ripple: str | None
    open_phase: str | None
    flash: bool = False


FLASH_HINT = "dqforge dqy --flash compares topologies and controllers, and says what to flash"


def answer_dqy(design: Design, request: WaveformRequest) -> Answer:
    """Shape the currents at the point of the request, or else of the design.

    Raises:
        InputError: An option is not understood, or as `compare_waveforms`.
    """
    stage("shaping the currents")
    settings = with_point(
        design.waveform,
        parse_option(request.torque, "torque", "--torque"),
        parse_option(request.speed, "speed", "--speed"),
        parse_option(request.ripple, "number", "--ripple"),
        request.open_phase,
    )
    found = compare_waveforms(design, settings)

    def figure() -> Figure:
        from dqforge.reports.waveforms.figures import plot_waveforms

        return plot_waveforms(found)

    tables = waveform_tables(design, found)
    plain: dict[str, PlainData] = {"waveforms": plain_waveforms(found)}
    if not request.flash:
        return Answer(design.name, tables, plain, figure, notes=(FLASH_HINT,))
    stage("comparing topologies and controllers")
    flashing, advice = what_to_flash(design, settings)
    tables += flash_tables(design, flashing, advice)
    return Answer(design.name, tables, plain | {"flashing": plain_flash(flashing, advice)}, figure)
