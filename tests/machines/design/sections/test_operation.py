"""Overmodulation in a design file: what it sets, and where it cannot be had."""

from __future__ import annotations

import math

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.topologies import amplitude_limit

DRIVE = "abb-ipmsm-2k2"


def drive(*lines: str, name: str = DRIVE) -> bytes:
    text = catalogue.read_text(name).decode()
    return text.replace("  strategy: mtpa\n", "\n".join(["  strategy: mtpa", *lines, ""])).encode()


def test_key_raises_the_largest_fundamental_of_all_that_ask_for_it() -> None:
    linear = load_text(drive(), "drive.yaml")
    assert linear.v_max == pytest.approx(540.0 / math.sqrt(3.0), rel=1e-15)
    hexagon = load_text(drive("  overmodulation: least-phase-error"), "drive.yaml")
    assert any("95.14 % of six-step" in remark for remark in hexagon.assumptions)
    assert hexagon.v_max == pytest.approx(540.0 * math.sqrt(3.0) * math.log(3.0) / math.pi)
    for method in ("least-phase-error", "least-magnitude-error"):
        whole = load_text(
            drive(
                f"  overmodulation: {method}",
                "  overmodulation_limit: 100 %",
                "  speed: 1400 rpm",
                "  voltage_margin: 5 %",
            ),
            "drive.yaml",
        )
        assert whole.v_max == pytest.approx(0.95 * 540.0 * 2.0 / math.pi)
        assert whole.inverter.overmodulation == method
        for modulation in MODULATORS:  # alternatives in budgets: their own linear range
            made = amplitude_limit(whole.inverter, modulation)
            own = MODULATORS[modulation].kind in ("sine", "third-harmonic")
            limit = MODULATORS[modulation].linear_limit if own else 2.0 / math.pi
            assert made == pytest.approx(540.0 * limit)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("  overmodulation: most-noise",), "least-phase-error"),
        (("  overmodulation_limit: 98 %",), "write overmodulation: least-phase-error, or remove"),
        (
            ("  overmodulation: least-phase-error", "  overmodulation_limit: 80 %"),
            "operation.overmodulation_limit",
        ),
        (
            (
                "  overmodulation: least-magnitude-error",
                "  speed: 1400 rpm",
                "  modulation: thipwm6",
            ),
            "write modulation: svpwm, or a discontinuous one",
        ),
    ],
)
def test_what_cannot_be_had_is_said(lines: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_text(drive(*lines), "drive.yaml")
    assert message in caught.value.message
    assert caught.value.line is not None


def test_integers_other_topologies_and_phase_machines_are_refused() -> None:
    method = "operation.overmodulation=least-phase-error"
    cases = (
        (DRIVE, "export.control=q15", "there is no q15 of it"),
        (DRIVE, "inverter.topology=six-leg", "six-leg has its own modulator"),
        ("salient-phase-waveforms", "export.prefix=machine", "any back-EMF"),
    )
    for name, other, message in cases:
        with pytest.raises(InputError, match=message):
            catalogue.load(name, (method, other))
