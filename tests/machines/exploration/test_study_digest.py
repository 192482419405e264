"""The digest of a study: the same for every way to write it, another for all that changes rows."""

from __future__ import annotations

import pytest
from broken_studies import BASE, changed

from dqforge.machines.exploration.row_designs import asked_of
from dqforge.machines.exploration.study_checks import study_of_text


def digest(text: str) -> str:
    return study_of_text(text.encode(), "study.yaml").digest


SAME = {
    "comments": "# one\n" + BASE.replace("fit.degree: 3", "fit.degree: 3  # two"),
    "name": changed(("name: Trial", "name: Another\nabout: text")),
    "unit": changed(("60 kHz", "60000 Hz"), ("900 W", "0.9 kW")),
    "order": changed(
        (
            "tolerances:\n  machine.resistance: {normal: 5 %}\n  inverter.v_dc: {uniform: 10 %}\n",
            "",
        ),
        (
            "draw:",
            (
                "tolerances:\n  inverter.v_dc: {uniform: 10 %}\n"
                "  machine.resistance: {normal: 5 %}\ndraw:"
            ),
        ),
    ),
    "form": changed(("[mtpa, id0]", "{values: [mtpa, id0]}")),
    "default": changed(("{normal: 5 %}", "{normal: 5 %, cut: 3}")),
    "set": changed(
        ("fit.degree: 3", "fit.degree: 3\n  machine.resistance: {value: 2e-3, kind: phase}")
    ),
}
OTHER = {
    "value": changed(("60 kHz", "61 kHz")),
    "order-of-values": changed(("[mtpa, id0]", "[id0, mtpa]")),
    "order-of-axes": changed(
        (
            (
                "  inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}\n"
                "  operation.strategy: [mtpa, id0]\n"
            ),
            (
                "  operation.strategy: [mtpa, id0]\n"
                "  inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}\n"
            ),
        )
    ),
    "set": changed(("fit.degree: 3", "fit.degree: 2")),
    "width": changed(("{normal: 5 %}", "{normal: 6 %}")),
    "seed": changed(("seed: 1", "seed: 2")),
    "limit": changed(("900 W", "901 W")),
    "count-on-a-grid": changed(("count: 10", "count: 11")),
    "drive": changed(("paper000-ipmsm-100kw", "vdyno-trampa-6340")),
}


@pytest.mark.parametrize("name", SAME)
def test_two_ways_to_write_a_study_have_one_digest(name: str) -> None:
    assert digest(SAME[name]) == digest(BASE)


@pytest.mark.parametrize("name", sorted(set(OTHER) - {"drive"}))
def test_other_rows_have_another_digest(name: str) -> None:
    assert digest(OTHER[name]) != digest(BASE)


def test_a_longer_study_begins_like_a_shorter_one() -> None:
    """Without a grid further draws come behind the others: parts of the short one stay."""
    drawn = (
        "dqforge_study: 1\nname: a\ndesign: paper000-ipmsm-100kw\n"
        "tolerances: {inverter.v_dc: {uniform: 10 %}}\ndraw: {count: 10, seed: 1}\n"
    )
    assert digest(drawn) == digest(drawn.replace("count: 10", "count: 1000"))
    assert digest(drawn) != digest(drawn.replace("seed: 1}", "seed: 2}"))


def test_what_differs_is_told_by_key() -> None:
    def asked(text: str) -> dict[str, object]:
        return asked_of(study_of_text(text.encode(), "study.yaml"))

    one, other = asked(BASE), asked(changed(("seed: 1", "seed: 2"), ("60 kHz", "61 kHz")))
    differ = sorted(key for key in one if one[key] != other.get(key))
    assert differ == ["draw.seed", "vary.inverter.switching_frequency"]
    assert one.keys() == other.keys()


def test_the_spacing_of_a_range_counts_for_a_search_alone() -> None:
    grid = """\
dqforge_study: 1
name: Trial
design: paper000-ipmsm-100kw
vary:
  inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 2}}
pareto: {minimise: [losses.total]}
"""
    spaced = grid.replace("count: 2", "count: 2, spacing: log")
    search = "search: {seed: 1}\n"
    assert digest(grid) == digest(spaced)
    assert digest(grid + search) != digest(spaced + search)
