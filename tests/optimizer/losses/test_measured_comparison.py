"""Measured losses beside the budget of a design: readers, rests of a known machine, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.losses.measured_losses import read_measured
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import compare_alternatives
from dqforge.optimizer.losses.measured_comparison import MeasuredComparison, compare_measured
from dqforge.reports.answers.losses import LossRequest, answer_losses
from dqforge.reports.losses.map_tables import measured_tables, plain_measured_losses

DRIVE = "paper001-pmsm-bench"
RPM = np.pi / 30.0


def table(column: str, values: FloatArray, torque: FloatArray, speed: FloatArray) -> bytes:
    rows = "".join(
        f"{n:.6g};{t:.9g};{v:.9g}\n" for n, t, v in zip(speed, torque, values, strict=True)
    )
    return f"n [rpm];T [N m];{column}\n{rows}".encode()


def points() -> tuple[FloatArray, FloatArray]:
    speed, torque = np.meshgrid([300.0, 800.0, 1500.0, 2200.0], [-0.8, -0.3, 0.4, 0.9])
    return torque.ravel(), speed.ravel()


def found(extra: FloatArray | float, whose: str = "machine") -> MeasuredComparison:
    """The design with an extra loss in W, by the power that its budget takes from the source."""
    design = catalogue.load(DRIVE)
    torque, speed = points()
    omega = speed * RPM
    only = Alternatives((design.strategy,), (design.operation.modulation,), (design.inverter.f_sw,))
    own = compare_alternatives(
        design,
        torque + design.machine.friction * omega,
        omega,
        only,
        design.operation.voltage_margin,
    ).budget
    bridge = own.conduction + own.dead_time + own.switching + own.capacitor
    power = np.asarray(own.input_power - (bridge if whose == "machine" else 0.0)).ravel()
    column = "p_el [W]" if whose == "machine" else "p_dc [W]"
    content = table(column, power + extra, torque, speed)
    return compare_measured(design, read_measured(content, "dyno.csv"))


@pytest.mark.parametrize("whose", ["machine", "drive"])
def test_a_machine_as_designed_leaves_nothing(whose: str) -> None:
    """By the power balance from source to shaft."""
    compared = found(0.0, whose)
    assert compared.reached.all()
    assert np.max(np.abs(compared.left)) < 1e-4


def test_what_is_left_goes_with_what_was_added() -> None:
    _, speed = points()
    omega = speed * RPM
    noise = np.random.default_rng(0).normal(0.0, 0.05, omega.size)
    compared = found(0.04 * omega + 2e-4 * omega**2 + noise)
    dry, square = compared.goes_with
    assert dry.low < 0.04 < dry.high
    assert square.low < 2e-4 < square.high
    assert not compared.below.any()
    (shown,) = measured_tables(compared)
    assert any("torque that does not depend on the speed" in note for note in shown.notes)
    assert json.dumps(plain_measured_losses(compared)["goes_with"])


def test_less_than_the_model_is_named_with_its_line() -> None:
    extra = np.full(16, 1.0)
    extra[5] = -4.0
    compared = found(extra)
    assert int(compared.below.sum()) == 1
    (shown,) = measured_tables(compared)
    assert any("below zero at 1 points, most on line 7 (-4 W)" in note for note in shown.notes)
    assert shown.rows[0][0] == "7"


@pytest.mark.parametrize(("span", "told"), [(0.09, False), (0.115, True)])
def test_speeds_that_are_nearly_one_say_nothing_of_the_speed(span: float, told: bool) -> None:
    speed = 1000.0 * np.linspace(1.0 - span, 1.0, 16)
    measured = read_measured(
        table("machine loss [W]", 20.0 + 0.1 * np.arange(16.0), np.full(16, 0.5), speed), "d.csv"
    )
    compared = compare_measured(catalogue.load(DRIVE), measured)
    assert bool(compared.goes_with) == told
    assert compared.rms == pytest.approx(np.linalg.norm(compared.left) / 4.0)
    np.testing.assert_array_equal(compared.below, compared.left < 0.0)
    np.testing.assert_allclose(compared.left, measured.loss - compared.model)
    np.testing.assert_allclose(compared.model, sum(compared.parts.values()))
    few = read_measured(
        table("machine loss [W]", np.full(4, 20.0), np.full(4, 0.5), np.linspace(300.0, 900.0, 4)),
        "d.csv",
    )
    assert compare_measured(catalogue.load(DRIVE), few).goes_with == ()


def test_efficiencies_and_powers_say_the_same_loss() -> None:
    """Shaft power 1 kW at 1000 rpm; 800 W come out where 1 kW brake."""
    torque = np.array([30.0, -30.0]) / np.pi
    speed = np.array([1000.0, 1000.0])
    for column, values in (
        ("machine efficiency [%]", [80.0, 80.0]),
        ("motor efficiency", [0.8, 0.8]),
        ("P_el [W]", [1250.0, -800.0]),
        ("machine loss [kW]", [0.25, 0.2]),
    ):
        read = read_measured(table(column, np.array(values), torque, speed), "dyno.csv")
        assert read.whose == "machine"
        assert read.loss == pytest.approx([250.0, 200.0], rel=1e-5)
    assert read_measured(table("p_dc [W]", np.ones(2), torque, speed), "d").whose == "drive"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"n [rpm];T [N m];efficiency\n1;2;0.5\n2;2;0.5\n", "does not say whose it is"),
        (b"n [rpm];T [N m];p\n1;2;5\n2;2;5\n", "no column of what was measured"),
        (b"n [rpm];drive loss [W];x\n1;2;5\n2;2;5\n", "no column for the torque"),
        (b"n [rpm];T [N m];drive efficiency [%]\n1;2;0\n2;2;50\n", "an efficiency of 0 %"),
    ],
)
def test_what_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_measured(content, "dyno.csv")


def test_the_command(tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_bytes(b"n [rpm];T [N m];drive loss [W]\n900;0.5;20\n1500;0.5;25\n")
    design = catalogue.load(DRIVE)
    answered = answer_losses(design, LossRequest(measured=tmp_path / "d.csv"), choice=False)
    assert answered.plain["measured_losses"]["of"] == "drive"
    with pytest.raises(InputError, match="omit the other options"):
        answer_losses(design, LossRequest(measured=tmp_path / "d.csv", margin="5 %"), choice=False)
