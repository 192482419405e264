"""What to flash: the emitted C beside the closed form, cycles, words and tables, and what is said
where a tool is missing.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from hidden_compilers import hide_compilers
from phase_shapes import paper_machine

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.optimizer.flashing_choice import (
    DEVIATIONS,
    FlashComparison,
    advise,
    compare_flashing,
    variant,
)
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.answers.dqy import (
    FLASH_HINT,
    WaveformRequest,
    advice_lines,
    answer_dqy,
    counted_rows,
    flash_tables,
    plain_flash,
    simulated_rows,
    what_to_flash,
)

NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


NEEDS_CORE = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="no cross compiler or no emulator",
)


@pytest.fixture(scope="module")
def drive() -> Design:
    """The paper's machine with the IGBTs that are known, tuned to 500 Hz."""
    library = catalogue.load("paper002-phase-waveforms")
    loop = replace(library.control.current_loop, bandwidth=2.0 * 3.141592653589793 * 500.0)
    inverter = catalogue.load("paper002-pmsm-nonsinusoidal").inverter
    return replace(
        library,
        phase_machine=paper_machine(),
        inverter=inverter,
        control=replace(library.control, current_loop=loop),
    )


@pytest.fixture(scope="module")
def found(drive: Design) -> FlashComparison:
    """The comparison in closed form."""
    return compare_flashing(drive)


@pytest.fixture(scope="module")
def solution(drive: Design) -> Solution:
    """Where current references come from."""
    return solve(variant(drive, "three-wire", "table", 1e-3))


def _only(found: FlashComparison, *rows: tuple[Topology, CurrentFrame]) -> FlashComparison:
    return replace(found, rows=tuple(found.row(*row) for row in rows))


@pytest.mark.slow
@NEEDS_COMPILER
def test_the_emitted_c_has_the_ripple_of_the_closed_form(
    found: FlashComparison, solution: Solution
) -> None:
    """Dead time of 1 us, and every deviation: within 0.6 % of the torque on three and six legs,
    noise within a third, and the table below 0.8 %.
    """
    chosen = _only(found, ("three-wire", "table"), ("six-leg", "dqx"))
    for row in simulated_rows(solution, chosen):
        assert row.simulated is not None
        assert row.ripple is not None
        assert row.simulated.plain == pytest.approx(row.ripple.plain, abs=7e-3)
        assert set(row.simulated.deviating) == set(DEVIATIONS)
        for name, share in row.simulated.deviating.items():
            away = 0.35 * share if name == "noise" else 1e-2
            assert row.ripple.deviating[name] == pytest.approx(share, abs=away)
        if row.frame == "table":
            assert row.simulated.plain < 8e-3


@NEEDS_CORE
def test_a_sample_of_the_table_costs_more_cycles_than_dq(
    found: FlashComparison, solution: Solution
) -> None:
    """Counted on the emulated core: hundreds of cycles for dq, twice as many for the table."""
    rows = counted_rows(solution, _only(found, ("three-wire", "dq"), ("three-wire", "table")))
    plain, table = (sum(row.cycles or (0.0, 0.0)) / 2.0 for row in rows)
    assert 400.0 < plain < 1000.0
    assert 1.5 * plain < table < 3.5 * plain


def test_without_a_compiler_the_closed_form_stands_and_it_is_said(
    drive: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither simulation nor cycles, the reasons named, the recommendation as it was."""
    hide_compilers(monkeypatch)
    found, advice = what_to_flash(drive, drive.waveform)
    assert "no C compiler" in found.unsimulated
    assert found.uncounted
    assert all(row.simulated is None and row.cycles is None for row in found.rows)
    assert advice.row is not None
    (main, _) = flash_tables(drive, found, advice)
    assert any("by closed form (no C compiler" in note for note in main.notes)
    assert any(note.startswith("no cycles: ") for note in main.notes)


def test_words_name_watts_and_tables_every_row(drive: Design, found: FlashComparison) -> None:
    """Saved and paid watts in one sentence for each other topology."""
    rated = replace(drive, waveform=replace(drive.waveform, torque=3.9))
    comparison = compare_flashing(rated)
    lines = advice_lines(advise(comparison))
    assert lines[0].startswith("flash star, the table with harmonic integrators")
    fourth = next(line for line in lines if line.startswith("the fourth leg"))
    assert "saves 0.68" in fourth
    assert "of copper and costs 2.3" in fourth
    assert "the neutral's leg loses 1.9" in fourth
    assert "that costs 1.6" in fourth
    assert any("six legs save" in line and "V lower" in line for line in lines)
    main, sensitive = flash_tables(rated, comparison, advise(comparison))
    assert len(main.rows) == len(sensitive.rows) == len(found.rows)
    assert [row[-1] for row in main.rows].count("flash this") == 1


def test_rows_that_cannot_be_run_say_why_in_words_and_data(drive: Design) -> None:
    """A link of 20 V: no row is flashed, and each has its obstacle."""
    weak = replace(drive, inverter=replace(drive.inverter, v_dc=20.0, device=None))
    comparison = compare_flashing(weak)
    advice = advise(comparison)
    assert advice_lines(advice)[0].startswith("flash none")
    plain = json.loads(json.dumps(plain_flash(comparison, advice), default=float))
    assert plain["flash"] is None
    assert all("the link ends at 20 V" in row["obstacle"] for row in plain["rows"])
    (main, _) = flash_tables(weak, comparison, advice)
    assert all(row[4] == "no device" for row in main.rows)


def test_without_the_flag_the_answer_ends_with_its_name(drive: Design) -> None:
    """One line, and nothing of it in the document."""
    answer = answer_dqy(drive, WaveformRequest(None, None, None, None))
    assert answer.notes == (FLASH_HINT,)
    assert "flashing" not in answer.plain


@pytest.mark.slow
@NEEDS_COMPILER
def test_the_whole_question_is_answered(drive: Design) -> None:
    """Fifteen rows from the emitted C; with harmonic integrators every topology keeps 2 %."""
    answer = answer_dqy(drive, WaveformRequest(None, None, None, None, flash=True))
    flashing = answer.plain["flashing"]
    assert flashing["unsimulated"] == ""
    for row in flashing["rows"]:
        assert row["ripple_simulated"]["plain"] < (0.02 if row["frame"] == "table" else 0.05)
    assert flashing["flash"] == {"topology": "three-wire", "frame": "table"}
