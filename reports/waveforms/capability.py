"""Phase currents of machines whose back-EMF is not sinusoidal, as records."""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.optimizer.solution import Solution
from dqforge.optimizer.waveforms.comparison import WaveformComparison
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Draw, Quantity, ReportPart
from dqforge.reports.pages.chapters import WAVEFORMS as CHAPTER
from dqforge.reports.waveforms.float32_model import phase_reference_from, plain_phase_reference
from dqforge.reports.waveforms.header import waveform_files, waveform_programme
from dqforge.reports.waveforms.html import point_words, waveform_part
from dqforge.reports.waveforms.tables import plain_phase_fit, plain_waveforms, waveform_tables

_SECTION = "phase currents"
_RULES = ("dq", "dqx", "dqy", "limited")


def _figures(_: Solution, comparison: WaveformComparison) -> Mapping[str, Draw]:
    from dqforge.reports.waveforms.figures import plot_waveforms

    return {"waveforms": lambda: plot_waveforms(comparison)}


def _parts(solution: Solution, found: WaveformComparison) -> list[ReportPart]:
    data, key = waveform_part(solution), point_words(found)
    return [] if data is None else [ReportPart(CHAPTER, "waveforms/report.html.j2", data, key)]


WAVEFORMS = Capability(
    name="waveforms",
    title="phase currents by rule",
    of=lambda outcome: outcome.solution.waveforms,
    plain=lambda _, comparison: plain_waveforms(comparison),
    tables=lambda solution, comparison: waveform_tables(solution.design, comparison),
    figures=_figures,
    parts=_parts,
    quantities=(
        Quantity(_SECTION, "torque", "N m", ("waveforms", "torque_Nm")),
        Quantity(_SECTION, "speed", "rpm", ("waveforms", "omega_m_rad_per_s")),
        *(
            Quantity(
                _SECTION, f"copper loss, {rule}", "W", ("waveforms", "rules", rule, "copper_W")
            )
            for rule in _RULES
        ),
    ),
)

PHASE_REFERENCE = Capability(
    name="waveform_fit",
    title="phase currents in the firmware",
    of=lambda outcome: outcome.solution.phases,
    plain=lambda _, fit: plain_phase_fit(fit),
    headers=(
        HeaderKind(
            name="waveform",
            files=lambda solution, fit: waveform_files(solution.design, fit),
            plain=lambda _, fit: plain_phase_reference(fit.reference),
            read=lambda own, _: phase_reference_from(own),
            programme=waveform_programme,
        ),
    ),
)
