"""Loss columns of finite-element maps: what becomes of known losses, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.map_names import loss_named
from dqforge.machines.losses.loss_columns import DeclaredLoss, LossMapReading, read_loss_map

I_D, I_Q = np.linspace(-100.0, 40.0, 8), np.linspace(0.0, 100.0, 6)
PLAIN = DeclaredLoss(4)
AT_200 = DeclaredLoss(4, 2.0 * np.pi * 200.0)
Loss = Callable[[FloatArray, FloatArray, float], FloatArray]


def hysteresis(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
    return np.asarray((0.2 + 1e-5 * (d - 50.0) ** 2 + 2e-5 * q**2) * f)


def eddy(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
    return np.asarray((1e-3 + 3e-8 * d**2 + 5e-8 * q**2) * f**2)


def magnet(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
    return np.asarray(2e-8 * (d**2 + q**2) * f**2)


def iron(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
    return hysteresis(d, q, f) + eddy(d, q, f)


def table(
    columns: Mapping[str, Loss], frequencies: tuple[float, ...] = (200.0,), *, speed: str = ""
) -> bytes:
    d, q = (part.ravel() for part in np.meshgrid(I_D, I_Q, indexing="ij"))
    rows = [f"i_d [A];i_q [A];{speed or 'frequency [Hz]'};{';'.join(columns)}"]
    for f in frequencies:
        values = [loss(d, q, f) for loss in columns.values()]
        at = f * 60.0 / 4.0 if speed else f
        rows += [
            f"{d[k]:.15g};{q[k]:.15g};{at:.15g};" + ";".join(f"{part[k]:.15g}" for part in values)
            for k in range(d.size)
        ]
    return "\n".join(rows).encode()


def check(found: LossMapReading, iron_loss: Loss, magnet_loss: Loss | None = None) -> None:
    """On grid points of both halves, at other frequencies than those of the file."""
    d, q = np.meshgrid(I_D, np.concatenate([-I_Q[:0:-1], I_Q]), indexing="ij")
    for f in (50.0, 700.0):
        of_iron, of_magnets = found.loss_map.losses(d, q, np.full(d.shape, -2.0 * np.pi * f))
        np.testing.assert_allclose(of_iron, iron_loss(d, np.abs(q), f), rtol=1e-9)
        wanted = np.zeros(d.shape) if magnet_loss is None else magnet_loss(d, q, f)
        np.testing.assert_allclose(of_magnets, wanted, rtol=1e-9, atol=1e-12)


def kilowatts(loss: Loss) -> Loss:
    return lambda d, q, f: loss(d, q, f) / 1e3


def test_parts_at_one_frequency_grow_with_f_and_f_squared() -> None:
    columns = {"P_hyst [W]": hysteresis, "P_eddy [kW]": kilowatts(eddy), "P_magnet [W]": magnet}
    found = read_loss_map(table(columns), "fe.csv", PLAIN)
    check(found, iron, magnet)
    assert found.findings == ()


def test_several_frequencies_are_fitted_point_by_point() -> None:
    columns = {"Core Loss [W]": iron, "P_magnets [W]": magnet}
    found = read_loss_map(table(columns, (100.0, 300.0, 500.0)), "fe.csv", PLAIN)
    check(found, iron, magnet)
    assert found.findings == ()


def test_a_column_of_speed_counts_with_the_pole_pairs() -> None:
    content = table({"P_fe": iron}, (100.0, 300.0), speed="speed [rpm]")
    check(read_loss_map(content, "fe.csv", PLAIN), iron)


def test_a_sum_and_one_part_give_the_other() -> None:
    check(read_loss_map(table({"P_iron": iron, "P_eddy": eddy}), "fe.csv", PLAIN), iron)
    with pytest.raises(InputError, match="is not hysteresis plus eddy loss"):
        read_loss_map(
            table({"P_iron": kilowatts(iron), "P_eddy": eddy, "P_hyst": hysteresis}), "a.csv", PLAIN
        )


def test_a_sum_at_one_frequency_needs_its_exponent() -> None:
    def power(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
        return np.asarray((1.0 + 1e-4 * (d**2 + q**2)) * f**1.5)

    content = table({"P_fe": power})
    with pytest.raises(InputError, match=r"write exponent: 1\.6"):
        read_loss_map(content, "fe.csv", PLAIN)
    check(read_loss_map(content, "fe.csv", DeclaredLoss(4, exponent=1.5)), power)


def test_a_fit_that_misses_and_a_part_below_zero_are_named() -> None:
    def falling(d: FloatArray, q: FloatArray, f: float) -> FloatArray:
        return np.asarray((0.2 + 1e-5 * q**2) * f * np.where(d < -90.0, (f / 100.0) ** -0.4, 1.0))

    found = read_loss_map(table({"P_fe": falling}, (100.0, 200.0, 400.0)), "fe.csv", PLAIN)
    told = " | ".join(found.findings)
    assert "eddy-current loss below zero at 6 of 48 points" in told
    assert "counts as zero there" in told
    assert "iron loss by f and f^2 leaves" in told
    assert "i_d = -100 A" in told
    # By hand: P/f falls at i_d = -100 A alone, where it counts as constant.
    f = np.array([100.0, 200.0, 400.0])
    made = np.array([[falling(np.array(-100.0), q, float(x)) for x in f] for q in I_Q])
    left = made - np.mean(made / f, axis=1, keepdims=True) * f
    worst = np.unravel_index(np.argmax(np.abs(left)), left.shape)
    rms = np.sqrt(np.sum(left**2) / (48 * f.size))
    numbers = [float(x) for x in re.findall(r"(?<![\w^.-])-?\d[\d.]*", told.split("leaves")[1])]
    expected = [rms, abs(left[worst]), -100.0, I_Q[worst[0]], f[worst[1]]]
    assert numbers == pytest.approx(expected, rel=1e-2)
    assert float(np.min(found.loss_map.iron.psi_q)) >= 0.0


def test_axes_of_reluctance_and_rms_currents_are_converted() -> None:
    d, q = (part.ravel() for part in np.meshgrid(I_D, I_Q, indexing="ij"))
    root = np.sqrt(2.0)
    rows = ["i_d,i_q,P_hyst,P_eddy"] + [
        f"{b / root:.15g},{-a / root:.15g},{h:.15g},{e:.15g}"
        for a, b, h, e in zip(d, q, hysteresis(d, q, 200.0), eddy(d, q, 200.0), strict=True)
    ]
    declared = DeclaredLoss(4, AT_200.frequency, axes="reluctance", scaling="rms")
    found = read_loss_map("\n".join(rows).encode(), "fe.csv", declared)
    check(found, iron)
    assert len(found.findings) == 2


def test_names_of_the_user_and_mechanical_loss() -> None:
    content = table({"A": iron, "P_mech [W]": lambda d, _q, f: 0.0 * d + f}, (100.0, 300.0))
    found = read_loss_map(content, "fe.csv", PLAIN, {"iron": "A"})
    check(found, iron)
    assert found.mechanical == pytest.approx(300.0)


GOOD = table({"P_iron [W]": iron}, (100.0, 300.0))


@pytest.mark.parametrize(
    ("content", "declared", "message"),
    [
        (GOOD.replace(b"frequency [Hz]", b"thing"), PLAIN, "frequency of the losses is not given"),
        (GOOD.replace(b"frequency [Hz]", b"frequency"), PLAIN, "has no unit"),
        (GOOD, AT_200, "has a column for it"),
        (GOOD, DeclaredLoss(4, exponent=1.5), "several frequencies, which tell it"),
        (GOOD.replace(b"P_iron [W]", b"other"), PLAIN, "no loss found"),
        (
            table({"P_fe": iron, "core loss": iron}, (100.0, 300.0)),
            PLAIN,
            "2 columns may be the iron",
        ),
        (GOOD.rpartition(b"\n")[0], PLAIN, r"i_d = 40 A, i_q = 100 A is missing at 300 Hz"),
        (GOOD.replace(b"\n-100;0;100;", b"\n-100;0;100;-"), PLAIN, "below zero at i_d = -100 A"),
        (re.sub(rb"(\n-100;20;100;).*", rb"\1nan", GOOD), PLAIN, "no number for the iron loss"),
        (GOOD.replace(b"\n-100;0;", b"\n-100;5;"), PLAIN, "save a full grid"),
    ],
)
def test_faults_are_refused_in_one_line(
    content: bytes, declared: DeclaredLoss, message: str
) -> None:
    with pytest.raises(InputError, match=message) as raised:
        read_loss_map(content, "fe.csv", declared)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "unit", "kind"),
    [
        ("P_fe", "W", "iron"),
        ("Fe", "kW", "iron"),
        ("fe", "", ""),  # a frequency
        ("fe", "Hz", ""),
        ("Core Loss", "", "iron"),
        ("P_hyst [W]", "", "hysteresis"),
        ("Eddy current loss", "W", "eddy"),
        ("Magnet Losses", "W", "magnet"),
        ("P_mech", "W", "mechanical"),
        ("pm", "Wb", ""),
        ("P_cu", "W", ""),
        ("Total loss", "W", ""),
    ],
)
def test_names_of_losses(name: str, unit: str, kind: str) -> None:
    assert loss_named(name, unit) == kind
