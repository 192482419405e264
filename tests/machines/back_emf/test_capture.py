"""Captures made from known harmonics, refusals of what is no capture,
and files that others measured or computed.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.capture import analyse, analyse_period
from dqforge.machines.back_emf.checks import Origin, check_certain, check_displacements
from dqforge.machines.back_emf.columns import BemfCapture, CaptureOptions, capture_from_tables
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable, read_table

AnyArray = NDArray[Any]

ORDERS: AnyArray = np.array([1, 2, 3, 5, 7, 9, 11, 13])
# Amplitudes of phase a in V s/rad times exp(-j phi); the fundamental is aligned.
AMPLITUDES: FloatArray = np.array([10.0, 0.08, 1.2, 0.5, 0.3, 0.2, 0.1, 0.08]) * 1e-3
PHASORS: AnyArray = AMPLITUDES * np.exp(1j * np.array([0.0, 1.0, 0.3, 2.0, 3.0, -1.0, 0.5, 4.0]))
PHASES = np.arange(3) * (2.0 * np.pi / 3.0)


def capture_from_table(table: TextTable, **options: Any) -> BemfCapture:
    """Samples in SI units from the columns of one file.

    The options are those of `CaptureOptions`.
    """
    return capture_from_tables([table], CaptureOptions(**options))


def written(headings: str, values: FloatArray) -> TextTable:
    """Table of a comma-separated file with these headings (parted by blanks) and numbers."""
    content = io.BytesIO()
    np.savetxt(
        content, values, fmt="%.17g", delimiter=",", header=headings.replace(" ", ","), comments=""
    )
    return read_table(content.getvalue(), "scope.csv")


def emf(theta: AnyArray, phasors: AnyArray = PHASORS) -> FloatArray:
    """e / omega_e of three equal phases, shape (3, N): -sum A sin(h (theta - k 120 deg) - phi)."""
    shifted = theta - PHASES[:, None]
    waves = [
        -np.abs(p) * np.sin(h * shifted + np.angle(p)) for h, p in zip(ORDERS, phasors, strict=True)
    ]
    return np.asarray(np.sum(waves, axis=0), dtype=np.float64)


def turns(angle: AnyArray) -> AnyArray:
    """Point of the unit circle, to compare angles."""
    return np.asarray(np.exp(1j * angle)).view(np.float64)


def capture(
    voltages: FloatArray, time: FloatArray | None = None, angle: FloatArray | None = None
) -> BemfCapture:
    return BemfCapture("scope.csv", time, angle, voltages, np.arange(2, voltages.shape[1] + 2))


def turning(
    count: int = 20_000,
    periods: float = 7.3,
    drift: float = 0.01,
    start: float = 1.0,
    frequency: float = 50.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time from -1/3 of the length on, electrical angle and speed, falling by the share
    ``drift`` over the record.
    """
    length = periods / frequency
    time = np.linspace(0.0, length, count, endpoint=False)
    omega = 2.0 * np.pi * frequency * (1.0 + drift * (0.5 - time / length))
    theta = start + 2.0 * np.pi * frequency * (
        (1.0 + 0.5 * drift) * time - 0.5 * drift * time**2 / length
    )
    return time - length / 3.0, theta, omega


def clean(count: int = 4000, **motion: float) -> BemfCapture:
    time, theta, omega = turning(count, **motion)
    return capture(omega * emf(theta), time)


def expected_amplitudes(highest: int) -> FloatArray:
    amplitudes = np.zeros(max(highest, ORDERS[-1]))
    amplitudes[ORDERS - 1] = np.abs(PHASORS)
    return amplitudes[:highest]


@pytest.mark.slow
def test_hundred_noisy_captures_give_the_harmonics_within_their_uncertainty() -> None:
    """10 bit, 2 % noise, 1 % offset, 7.3 periods, 1 % drift: within 0.3 %,
    and covered 95 times of 100 or more.
    """
    generator = np.random.default_rng(1)
    truth = expected_amplitudes(13)
    errors, widths = np.empty((100, 3, 13)), np.empty((100, 3, 13))
    for seed in range(100):
        time, theta, omega = turning(start=generator.uniform(0.0, 6.3))
        volts = omega * emf(theta)
        size = truth[0] * 2.0 * np.pi * 50.0
        volts += size * (
            0.02 * generator.standard_normal(volts.shape) + 0.01 * np.array([[1.0], [-1.0], [0.5]])
        )
        step = 2.6 * size / 1024.0
        result = analyse(capture(step * np.round(volts / step), time), harmonics=13)
        errors[seed], widths[seed] = result.amplitudes - truth, result.amplitude_uncertainty
        assert result.sequence == "abc"
    assert np.max(np.abs(errors)) < 0.003 * truth[0]
    covered = np.mean(np.abs(errors) <= widths, axis=0)
    assert np.mean(covered) >= 0.95
    assert np.min(covered) >= 0.88
    # An interval that is far too wide would cover everything.
    assert np.median(widths) < 3.5 * np.sqrt(np.mean(errors**2))


def test_uncertainty_covers_noise_that_is_not_white() -> None:
    """Noise with most of its power at low frequencies disturbs the low harmonics
    more than white noise would.
    """
    from scipy.signal import lfilter

    generator = np.random.default_rng(2)
    truth = expected_amplitudes(9)
    covered = np.zeros((3, 9))
    for _ in range(40):
        time, theta, omega = turning(4000, periods=12.4)
        noise = lfilter([0.3], [1.0, -0.97], generator.standard_normal((3, time.size)), axis=1)
        result = analyse(capture(omega * emf(theta) + 0.1 * noise, time), harmonics=9)
        covered += np.abs(result.amplitudes - truth) <= result.amplitude_uncertainty
    assert np.mean(covered) / 40.0 >= 0.95
    assert np.min(covered) / 40.0 >= 0.8


@pytest.mark.parametrize("bits", [6, 8, 10])
def test_uncertainty_covers_rounding_without_noise(bits: int) -> None:
    """Rounding errors repeat in every period then, so that the residual does not show them."""
    truth = expected_amplitudes(13)
    covered = []
    for start in np.linspace(0.0, 6.0, 10):
        time, theta, omega = turning(4000, periods=8.0, drift=0.0, start=float(start))
        step = 8.0 / 2.0**bits
        result = analyse(capture(step * np.round(omega * emf(theta) / step), time), harmonics=13)
        covered.append(np.abs(result.amplitudes - truth) <= result.amplitude_uncertainty)
        assert np.max(result.amplitude_uncertainty) < step / omega[0]
    assert np.mean(covered) >= 0.95


@pytest.mark.parametrize("start", [0.0, 1.0, 3.5, 6.0])
@pytest.mark.parametrize(
    ("periods", "drift"), [(1.3, 0.0), (2.6, 0.02), (4.5, -0.1), (7.3, 0.01), (83.7, 0.3)]
)
def test_noiseless_capture_is_recovered_and_aligned(
    start: float, periods: float, drift: float
) -> None:
    result = analyse(
        clean(int(400 * periods), start=start, periods=periods, drift=drift), harmonics=15
    )
    np.testing.assert_allclose(
        result.amplitudes, np.tile(expected_amplitudes(15), (3, 1)), atol=1e-8
    )
    np.testing.assert_allclose(turns(result.phases[:, 0]), turns(PHASES), atol=1e-5)
    np.testing.assert_allclose(
        turns(result.phases[0, ORDERS - 1]), turns(-np.angle(PHASORS)), atol=1e-4
    )
    np.testing.assert_allclose(result.waveform, emf(np.arange(360) * np.pi / 180.0), atol=1e-7)
    assert result.psi_pm == pytest.approx(0.01, rel=1e-5)
    # The mean of the speed over the samples, of which the last stands a little before
    # the end of the last period.
    assert result.frequency == pytest.approx(
        50.0 * (1.0 + 0.5 * drift / int(400 * periods)), rel=1e-6
    )
    assert result.drift == pytest.approx(-drift, abs=max(1e-4, 2e-3 * drift))
    assert result.periods == pytest.approx(periods, rel=1e-4)
    assert np.exp(1j * result.start_angle) == pytest.approx(np.exp(1j * start), abs=1e-4)


def test_machine_turning_backwards_has_the_same_waveform() -> None:
    """theta falls and omega_e is negative, for a waveform without any symmetry."""
    time, theta, omega = turning(4000)
    result = analyse(capture(-omega * emf(-theta), time), harmonics=15)
    assert result.sequence == "acb"
    assert any("backwards" in finding for finding in result.findings)
    np.testing.assert_allclose(result.waveform, emf(np.arange(360) * np.pi / 180.0), atol=1e-8)
    assert np.exp(1j * result.start_angle) == pytest.approx(np.exp(-1j), abs=1e-6)


def test_swapped_channels_are_told() -> None:
    good = clean()
    result = analyse(replace(good, voltages=good.voltages[[0, 2, 1]]))
    assert result.sequence == "acb"
    assert result.psi_pm == pytest.approx(0.01, rel=1e-6)
    np.testing.assert_allclose(result.phases[:, 0], [0.0, PHASES[1], -PHASES[1]], atol=1e-6)


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_line_to_line_voltages_give_phases_without_zero_sequence(channels: int) -> None:
    time, theta, omega = turning(4000)
    phases = omega * emf(theta)
    lines = (phases - np.roll(phases, -1, axis=0))[:channels]
    table = written("t_s ab_mV bc_mV ca_mV"[: 3 + 6 * channels], np.vstack([time, 1e3 * lines]).T)
    result = analyse(capture_from_table(table, connection="line-to-line"), harmonics=15)
    known = np.arange(1, 16) % 3 != 0
    np.testing.assert_allclose(
        result.amplitudes[:, known], np.tile(expected_amplitudes(15)[known], (3, 1)), atol=1e-8
    )
    assert np.all(result.amplitudes[:, ~known] == 0.0)
    assert np.all(np.isnan(result.amplitude_uncertainty) == ~known)
    assert not result.zero_sequence_known
    assert any("unknown" in finding for finding in result.findings)
    assert any("taken for equal" in finding for finding in result.findings) == (channels == 1)
    np.testing.assert_allclose(result.phases[:, 0], [0.0, PHASES[1], -PHASES[1]], atol=1e-6)
    own = np.isin(result.orders, ORDERS) & known
    np.testing.assert_allclose(
        turns(result.phases[0, own]),
        turns(-np.angle(PHASORS[np.isin(ORDERS, result.orders[own])])),
        atol=1e-5,
    )
    as_phases = analyse(replace(capture(phases, time), connection="line-to-line"))
    assert any("are they phase voltages" in finding for finding in as_phases.findings)


def test_two_line_to_line_voltages_must_fit_each_other() -> None:
    time, theta, omega = turning(4000)
    lines = omega * (emf(theta) - np.roll(emf(theta), -1, axis=0))
    for factor, message in (
        (0.1, "fundamentals are as 1, 0.1; check"),
        (-1.0, "is 300 degrees behind .*wrong way round"),
    ):
        table = written("t_s ab_V bc_V", np.vstack([time, lines[0], factor * lines[1]]).T)
        with pytest.raises(InputError, match=message):
            analyse(capture_from_table(table, connection="line-to-line"))


def test_uneven_sampling_needs_no_resampling() -> None:
    time, theta, omega = turning(6000)
    keep = np.sort(np.random.default_rng(3).choice(6000, 2500, replace=False))
    result = analyse(capture((omega * emf(theta))[:, keep], time[keep]), harmonics=13)
    np.testing.assert_allclose(
        result.amplitudes, np.tile(expected_amplitudes(13), (3, 1)), atol=1e-9
    )


def test_asymmetry_offset_noise_even_harmonics_and_drift_are_measured_and_told() -> None:
    time, theta, omega = turning(4000, drift=0.2)
    phasors = PHASORS.copy()
    phasors[1] = 0.5e-3
    volts = omega * emf(theta, phasors) * np.array([[1.0], [1.0], [0.8]])
    volts[1] += 0.5
    volts += 0.3 * np.random.default_rng(4).standard_normal(volts.shape)
    result = analyse(capture(volts, time))
    assert result.offsets == pytest.approx([0.0, 0.5, 0.0], abs=0.02)
    assert result.noise == pytest.approx([0.3, 0.3, 0.3], rel=0.05)
    for text in (
        "Phase b has an offset",
        "noise",
        "differ from their mean",
        "Even harmonics",
        "speed changes by -",
    ):
        assert any(text in finding for finding in result.findings), text


def test_symmetry_of_a_noiseless_capture() -> None:
    """Phase c of 80 %, 3 degrees late, an even harmonic of 5 %."""
    time, theta, omega = turning(4000)
    phasors = PHASORS.copy()
    phasors[1] = 0.5e-3
    volts = omega * emf(theta, phasors)
    volts[2] = 0.8 * omega * emf(theta - np.radians(3.0), phasors)[2]
    symmetry = analyse(capture(volts, time)).symmetry
    assert symmetry.amplitude == pytest.approx(1.0 - 0.8 / (2.8 / 3.0), abs=1e-6)
    assert symmetry.even == pytest.approx(0.05, abs=1e-6)
    # The d axis is the positive sequence of all three, so that phase c shifts it a little.
    shift = np.angle(2.0 + 0.8 * np.exp(-1j * np.radians(3.0)))
    assert symmetry.displacement == pytest.approx(np.radians(3.0) + shift, abs=1e-6)
    waves = emf(np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False), phasors)[0]
    half_wave = np.max(np.abs(waves + np.roll(waves, 360))) / 2.0 / np.max(np.abs(waves))
    assert symmetry.half_wave == pytest.approx(half_wave, abs=1e-4)


def trapezoid(theta: FloatArray) -> FloatArray:
    """Three trapezoids of height 1 with 120 degrees of flat top, shape (3, N)."""
    return np.clip((6.0 / np.pi) * np.arcsin(np.sin(theta - PHASES[:, None])), -1.0, 1.0)


def test_flat_top_of_a_trapezoid_is_not_clipping() -> None:
    """Fourier: A_h = 24 / (pi^2 h^2) sin(h pi / 6) for the odd orders."""
    time, theta, omega = turning(8000, drift=0.0)
    volts = trapezoid(theta) + 0.01 * np.random.default_rng(5).standard_normal((3, time.size))
    step = 2.0**-8
    orders = np.arange(1, 14, 2)
    result = analyse(capture(step * np.round(volts / step), time))
    series = 24.0 / (np.pi * orders) ** 2 * np.abs(np.sin(orders * np.pi / 6.0)) / omega[0]
    np.testing.assert_allclose(
        result.amplitudes[:, orders - 1], np.tile(series, (3, 1)), atol=2e-3 / omega[0]
    )
    assert not any("range of the oscilloscope" in finding for finding in result.findings)
    noiseless = analyse(capture(step * np.round(trapezoid(theta) / step), time))
    assert any("range of the oscilloscope" in finding for finding in noiseless.findings)


def spoiled(change: Callable[[BemfCapture, np.random.Generator], BemfCapture]) -> BemfCapture:
    """A good capture with 1 % noise (amplitude about 3.1 V), then changed."""
    generator = np.random.default_rng(6)
    good = clean()
    return change(
        replace(good, voltages=good.voltages + 0.03 * generator.standard_normal((3, 4000))),
        generator,
    )


def with_channel(capture: BemfCapture, channel: int, values: FloatArray | float) -> BemfCapture:
    voltages = capture.voltages.copy()
    voltages[channel - 1] = values
    return replace(capture, voltages=voltages)


def timed(capture: BemfCapture, sample: int, value: float) -> BemfCapture:
    assert capture.time is not None
    time = capture.time.copy()
    time[sample] = value
    return replace(capture, time=time)


def part(capture: BemfCapture, select: slice) -> BemfCapture:
    assert capture.time is not None
    return replace(
        capture,
        time=capture.time[select],
        voltages=capture.voltages[:, select],
        lines=capture.lines[select],
    )


def burst(capture: BemfCapture, generator: np.random.Generator) -> BemfCapture:
    values = capture.voltages[0].copy()
    values[1500:] = 4.0 * generator.standard_normal(2500)
    return with_channel(capture, 1, values)


def quadrature(capture: BemfCapture, _: np.random.Generator) -> BemfCapture:
    theta, omega = turning(4000)[1:]
    return with_channel(capture, 3, omega * emf(theta - 0.5 * np.pi)[0])


REFUSED: dict[
    str, tuple[Callable[[BemfCapture, np.random.Generator], BemfCapture], str, int | None]
] = {
    "flat": (lambda c, _: with_channel(c, 2, 0.1), r"channel 2 is dead: it stays at 0\.1 V", 2),
    "noise only": (
        lambda c, g: with_channel(c, 3, 0.02 * g.standard_normal(4000)),
        "channel 3 is dead or comes loose: only [0-9]% of it has",
        2,
    ),
    "probe": (
        lambda c, _: with_channel(c, 1, c.voltages[0] / 10.0),
        r"channel 1 reads 10\.0 times less .*--scale 10,1,1, in a design scale: \[10, 1, 1\]",
        2,
    ),
    "probe up": (
        lambda c, _: with_channel(c, 2, c.voltages[1] * 100.0),
        r"100\.0 times more .*--scale 1,0\.01,1,",
        2,
    ),
    "two probes": (
        lambda c, _: replace(c, voltages=c.voltages * np.array([[1.0], [10.0], [50.0]])),
        r"fundamentals are as 0\.02, 0\.2, 1",
        2,
    ),
    "identical": (
        lambda c, _: with_channel(c, 2, c.voltages[0]),
        "channel 2 is (0|360) degrees .*channels 1 and 2 show",
        2,
    ),
    "reversed": (
        lambda c, _: with_channel(c, 2, -c.voltages[1]),
        "channel 2 is 300 degrees .*the wrong way round",
        2,
    ),
    "quadrature": (quadrature, "channel 3 is 90 degrees behind .*check what", 2),
    "burst": (burst, "channel 1 is dead or comes loose: only [0-9]+% of it has", None),
    "drop-out": (
        lambda c, _: with_channel(
            c, 2, np.where(np.abs(np.arange(4000) - 2500) < 250, 0.0, c.voltages[1])
        ),
        r"channel 2 departs here from the period of the rest \(harmonics of 50.* Hz\)",
        None,
    ),
    "not periodic": (
        lambda c, g: replace(c, voltages=c.voltages + 3.0 * g.standard_normal((3, 4000))),
        "not periodic: harmonics of 50.* Hz explain 3[0-9]% of channel",
        None,
    ),
    "all noise": (
        lambda c, g: replace(c, voltages=g.standard_normal((3, 4000))),
        "no frequency stands out",
        2,
    ),
    "clipped": (
        lambda c, _: replace(c, voltages=np.minimum(c.voltages, 2.5)),
        r"channel 1 stand at 2\.5 V: clipped",
        None,
    ),
    "part of a period": (
        lambda c, _: part(c, slice(0, 420)),
        r"about 0\.[678]\d electrical periods",
        2,
    ),
    "time back": (lambda c, _: timed(c, 30, -1.0), "is before the time of the last line", 32),
    "time twice": (
        lambda c, _: timed(c, 31, float(c.time[30]) if c.time is not None else 0.0),
        "digits",
        33,
    ),
    "hole": (
        lambda c, _: with_channel(c, 2, np.where(np.arange(4000) == 7, np.nan, c.voltages[1])),
        "missing",
        9,
    ),
    "few samples": (
        lambda c, _: part(c, slice(0, 4000, 90)),
        "6.1 samples in an electrical period",
        2,
    ),
    "very few": (lambda c, _: part(c, slice(0, 10)), "10 samples are too few", None),
    "two channels": (
        lambda c, _: replace(c, voltages=c.voltages[:2]),
        "needs three channels, got 2",
        None,
    ),
    "neither": (lambda c, _: replace(c, time=None), "either times or angles", None),
    "shapes": (lambda c, _: replace(c, lines=c.lines[1:]), "as many samples as times", None),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_capture_is_refused_with_file_and_line(name: str) -> None:
    change, message, line = REFUSED[name]
    with pytest.raises(InputError, match=message) as caught:
        analyse(spoiled(change))
    assert caught.value.source == "scope.csv"
    if line is not None:
        assert caught.value.line == line


def test_refusals_point_to_where_the_trouble_begins() -> None:
    """Noise from sample 1500 on; a crest above 2.5 V of 3.1 V first comes within the
    first period (548 samples).
    """
    with pytest.raises(InputError) as caught:
        analyse(spoiled(burst))
    assert caught.value.line is not None
    assert 1000 < caught.value.line < 2100
    capture = spoiled(lambda c, _: replace(c, voltages=np.minimum(c.voltages, 2.5)))
    with pytest.raises(InputError) as caught:
        analyse(capture)
    assert caught.value.line is not None
    assert capture.voltages[0, caught.value.line - 2] == 2.5
    assert caught.value.line < 560


@pytest.mark.parametrize(
    ("braking", "message"), [(1.04, "stops or turns back"), (1.5, "not periodic")]
)
def test_machine_that_turns_back_is_refused(braking: float, message: str) -> None:
    """The speed falls from its greatest by 104 or 150 % to the end of the record."""
    share = np.linspace(0.0, 1.0, 8000)
    theta = 2.0 * np.pi * 12.0 * (share - 0.5 * braking * share**2)
    with pytest.raises(InputError, match=message):
        analyse(capture(300.0 * (1.0 - braking * share) * emf(theta), share))


def test_harmonics_that_the_sampling_does_not_resolve_are_left_out() -> None:
    result = analyse(clean(300, periods=7.5), harmonics=25)
    assert result.orders[-1] == 10
    assert any("up to order 10, not 25" in finding for finding in result.findings)


def test_speed_must_agree_with_the_frequency() -> None:
    good = clean()
    speed = 2.0 * np.pi * 50.0 / 4.0
    assert analyse(good, pole_pairs=4, speed=speed).psi_pm == pytest.approx(0.01, rel=1e-6)
    assert analyse(good, pole_pairs=4, speed=-1.04 * speed).psi_pm == pytest.approx(0.01, rel=1e-6)
    with pytest.raises(
        InputError,
        match=r"750 rpm and 8 pole pairs make 100 Hz, .* 50 Hz, .* 375 rpm or 4\.00 pole",
    ):
        analyse(good, pole_pairs=8, speed=speed)
    with pytest.raises(InputError, match="make 0 Hz"):
        analyse(good, pole_pairs=8, speed=0.0)


def test_fundamental_must_exceed_its_uncertainty() -> None:
    origin = Origin("scope.csv", np.arange(2, 9))
    fundamentals = np.ones(3)
    assert check_certain(fundamentals, np.array([0.1, 0.2, 0.0]), origin) == []
    assert "uncertain by 30%" in check_certain(fundamentals, np.array([0.1, 0.3, 0.0]), origin)[0]
    with pytest.raises(InputError, match="less than its uncertainty"):
        check_certain(fundamentals, np.array([0.1, 1.0, 0.0]), origin)


def test_short_captures_say_what_is_assumed() -> None:
    for periods, text in (
        (1.3, "assumes white noise and constant speed"),
        (1.8, "assumes white noise."),
    ):
        assert any(
            text in finding for finding in analyse(clean(600, periods=periods, drift=0.0)).findings
        )
    assert not any("assumes" in finding for finding in analyse(clean(2000, periods=4.0)).findings)


@pytest.mark.parametrize("both_ends", [True, False])
def test_period_over_the_angle_is_exact_with_and_without_its_end(both_ends: bool) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=both_ends)
    volts = 4.0 * 100.0 * emf(angle + 0.7)
    result = analyse(capture(volts, angle=angle), pole_pairs=4, speed=100.0)
    np.testing.assert_allclose(
        result.amplitudes, np.tile(expected_amplitudes(25), (3, 1)), atol=1e-14
    )
    assert result.start_angle == pytest.approx(0.7)
    assert np.isnan(result.frequency)
    assert result.periods == pytest.approx(1.0)
    bare = analyse(capture(volts, angle=angle))
    np.testing.assert_allclose(bare.amplitudes, 400.0 * result.amplitudes, atol=1e-12)
    assert any("No speed was given" in finding for finding in bare.findings)
    with pytest.raises(InputError, match="need the number of pole pairs"):
        analyse(capture(volts, angle=angle), speed=100.0)
    one = analyse_period(angle, emf(angle + 0.7)[0], source="fea.csv")
    np.testing.assert_allclose(one.waveform, emf(np.arange(360) * np.pi / 180.0), atol=1e-13)


def test_angles_that_leave_a_gap_are_refused() -> None:
    angle = np.linspace(0.0, 1.7 * np.pi, 100)
    with pytest.raises(InputError, match=r"^scope\.csv:2: .* leave 54 degrees"):
        analyse(capture(emf(angle), angle=angle))


def test_flux_linkage_over_the_angle_is_differentiated() -> None:
    angle = np.linspace(0.0, 360.0, 180, endpoint=False)
    psi = np.cos(np.radians(angle) + 0.2 - PHASES[:, None]) + 0.1 * np.cos(
        3.0 * (np.radians(angle) + 0.2)
    )
    table = written("theta_e_deg psi_a_mWb psi_b_mWb psi_c_mWb", np.vstack([angle, psi]).T)
    result = analyse(capture_from_table(table))
    np.testing.assert_allclose(
        result.amplitudes[:, :3], 1e-3 * np.array([[1.0, 0.0, 0.3]] * 3), atol=1e-15
    )
    assert result.start_angle == pytest.approx(0.2)


def test_columns_units_and_scale_are_read_from_the_table() -> None:
    good = clean()
    assert good.time is not None
    values = np.vstack([1e3 * good.time, good.voltages, np.ones(4000)]).T
    plain = analyse(good)
    cases: list[tuple[str, dict[str, Any]]] = [
        ("Time(ms) CH1(V) CH2(V) CH3(V) I(A)", {}),
        ("t[ms] a[V] b[V] c[V] x", {}),
        ("q r s t u", {"time_unit": "ms", "columns": (1, 2, 3, 4)}),
        ("t_ms e_A e_B e_C x", {"columns": ("t", "e_A", "e_B", "e_C"), "voltage_unit": "Volt"}),
    ]
    for headings, options in cases:
        found = analyse(capture_from_table(written(headings, values), **options))
        np.testing.assert_allclose(found.amplitudes, plain.amplitudes, rtol=1e-6, atol=1e-12)
    table = written("t_ms a_V b_V c_V", values[:, :4] * np.array([1.0, 1.0, 0.1, -1.0]))
    with pytest.raises(InputError, match=r"--scale 1,10,1, in a design scale: \[1, 10, 1\]"):
        analyse(capture_from_table(table))
    found = analyse(capture_from_table(table, scale=(1.0, 10.0, -1.0)))
    np.testing.assert_allclose(found.amplitudes, plain.amplitudes, rtol=1e-6, atol=1e-12)


def test_mechanical_angle_needs_pole_pairs() -> None:
    angle = np.linspace(0.0, 90.0, 91)
    values = np.vstack([angle, emf(np.radians(4.0 * angle))]).T
    table = written("theta_mech_deg e_a_V e_b_V e_c_V", values)
    with pytest.raises(InputError, match="theta_mech is a mechanical angle"):
        capture_from_table(table)
    assert analyse(capture_from_table(table, pole_pairs=4)).psi_pm == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        ("t_s a_V b_V", {}, r"2 channels \(a, b\): a third phase is needed"),
        ("t_s a_V", {}, "1 channel .*three phases are needed.* --line-to-line, in a design"),
        ("t a b c d", {}, r"4 columns of voltages \(a, b, c, d\)"),
        ("t a b c", {"columns": ("t", "a", "b", "z")}, "no column 'z'; the file has t, a, b, c"),
        ("t a b c", {"columns": (1, 2, 3, 9)}, "no column 9"),
        ("t a b c", {"scale": (1.0, 0.0, 1.0)}, "scale must be three factors"),
        ("t a b c", {"scale": (1.0, 10.0)}, "scale must be three factors"),
        ("t a b c", {"time_unit": "V"}, "t has the unit 'V', expected e.g. s or rad"),
        ("t a b c", {"voltage_unit": "furlong"}, "unit 'furlong', expected e.g. V or Wb"),
        ("t_s a_Wb b_Wb c_Wb", {}, "flux linkages are read over an angle"),
        (
            "theta_rad a_Wb b_V c_V",
            {"columns": (1, 2, 3, 4)},
            "flux linkages are read over an angle, and not beside",
        ),
        ("t i(A) j(A) k(A)", {}, "i has the unit 'A'"),
    ],
)
def test_tables_that_are_no_capture_are_refused(
    names: str, options: dict[str, Any], message: str
) -> None:
    table = written(names, np.random.default_rng(7).standard_normal((50, len(names.split()))))
    with pytest.raises(InputError, match=message) as caught:
        capture_from_table(table, **options)
    assert caught.value.source == "scope.csv"


def measured(path: Path) -> TextTable:
    return read_table(path.read_bytes(), path.name)


@pytest.mark.parametrize(
    ("rpm", "frequency", "flux", "fifth"),
    [(250, 29.114, 5.47e-3, 0.023), (500, 58.298, 5.43e-3, 0.032)],
)
def test_measured_machine_with_one_probe_set_otherwise(
    shared_data: Path, rpm: int, frequency: float, flux: float, fifth: float
) -> None:
    table = measured(shared_data / "bemf" / f"vdyno_trampa6340_0{rpm}rpm1_dec10.csv")
    with pytest.raises(InputError, match=r"channel 3 reads 10\.0 times less .* --scale 1,1,10,"):
        analyse(capture_from_table(table))
    result = analyse(
        capture_from_table(table, scale=(1.0, 1.0, 10.0)), pole_pairs=7, speed=rpm * np.pi / 30.0
    )
    assert result.frequency == pytest.approx(frequency, rel=1e-3)
    assert result.sequence == "abc"
    assert result.psi_pm == pytest.approx(flux, rel=3e-3)
    assert np.mean(result.amplitudes[:, 4] / result.amplitudes[:, 0]) == pytest.approx(
        fifth, abs=2e-3
    )
    assert np.max(np.abs(result.offsets)) == pytest.approx(0.22, abs=0.01)
    # The two speeds are one machine: the uncertainty has to own up to the ripple of
    # every mechanical revolution.
    assert np.all(
        np.abs(result.amplitudes[:, 0] - 5.45e-3) < result.amplitude_uncertainty[:, 0] + 2e-5
    )


def test_one_voltage_between_two_wires_gives_the_flux_of_three(shared_data: Path) -> None:
    table = measured(shared_data / "bemf" / "vdyno_trampa6340_0500rpm1_dec10.csv")
    whole = capture_from_table(table, scale=(1.0, 1.0, 10.0))
    three = analyse(whole, pole_pairs=7)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        wires = replace(
            whole,
            voltages=(whole.voltages[a] - whole.voltages[b])[None],
            connection="line-to-line",
        )
        one = analyse(wires, pole_pairs=7)
        # The phases differ by 0.34 % and 0.6 degrees.
        assert one.psi_pm == pytest.approx(three.psi_pm, rel=0.01)
        fifth = one.amplitudes[0, 4] / one.amplitudes[0, 0]
        assert fifth == pytest.approx(0.0323, abs=0.004)
        assert one.pole_pairs is None


def test_single_channels_of_a_drill_are_no_three_phase_capture(shared_data: Path) -> None:
    folder = shared_data / "bemf"
    yellow, red = (
        measured(folder / "vdyno_drill_YellowA0001CH1.CSV"),
        measured(folder / "vdyno_drill_RedA0001CH2.CSV"),
    )
    for single in (yellow, red):
        with pytest.raises(InputError, match=r"1 channel .*: three phases are needed"):
            capture_from_table(single)
    both = written("t_s ch1_V ch2_V", np.column_stack([yellow.values, red.values[:, 1]]))
    with pytest.raises(InputError, match=r"2 channels .*: a third phase is needed"):
        capture_from_table(both)
    with pytest.raises(
        InputError, match=r"channel 2 is 177 degrees behind channel 1; .*check what"
    ):
        analyse(capture_from_table(both, connection="line-to-line"))


def test_published_period_that_contains_both_ends(shared_data: Path) -> None:
    from scipy.io import loadmat

    angle = loadmat(shared_data / "bemf" / "yepes2024_angle.mat")["angle"].ravel()
    values = loadmat(shared_data / "bemf" / "yepes2024_backEMF.mat")["backEMF"].ravel()
    result = analyse_period(angle, values, source="yepes2024_backEMF.mat")
    share = 100.0 * result.amplitudes[0] / result.amplitudes[0, 0]
    assert result.psi_pm == pytest.approx(1.2236, abs=1e-4)
    assert share[[2, 4, 6]] == pytest.approx([8.84, 2.80, 1.18], abs=6e-3)
    assert np.all(share[1::2] < 0.2)


def test_finite_element_period_in_volts(shared_data: Path) -> None:
    table = measured(shared_data / "bemf" / "femag_test002_noload_3ph_p4_50rps.csv")
    capture = capture_from_table(table, pole_pairs=4)
    assert np.max(np.abs(capture.voltages)) == pytest.approx(220.4, abs=0.05)
    result = analyse(capture, pole_pairs=4, speed=100.0 * np.pi)
    share = result.amplitudes / result.amplitudes[:, :1]
    assert np.all((share[:, 2] > 0.12) & (share[:, 2] < 0.13))
    assert np.all((share[:, 4] > 0.055) & (share[:, 4] < 0.059))
    assert np.all((share[:, 8] > 0.06) & (share[:, 8] < 0.07))
    linkages = ("theta_mech", "psi_a", "psi_b", "psi_c")
    flux = analyse(capture_from_table(table, pole_pairs=4, columns=linkages))
    assert flux.psi_pm == pytest.approx(result.psi_pm, rel=5e-3)
    assert flux.start_angle == pytest.approx(result.start_angle, abs=1e-3)


def test_finite_element_flux_linkage(shared_data: Path) -> None:
    """The grid ends one step before 360 degrees, so that an FFT of the columns, times the order,
    is the truth.
    """
    table = measured(shared_data / "bemf" / "thor_noload_phase_flux.csv")
    result = analyse(capture_from_table(table))
    orders = np.arange(1, 26)
    truth = orders * np.abs(np.fft.rfft(table.values[:, 1:], axis=0)[1:26].T) / 90.0
    np.testing.assert_allclose(result.amplitudes, truth, atol=1e-12)
    share = 100.0 * result.amplitudes[0] / result.amplitudes[0, 0]
    assert share[[2, 4, 14]] == pytest.approx([16.3, 1.25, 4.93], abs=0.02)


def test_messages_stay_on_one_line_and_name_the_file() -> None:
    with pytest.raises(InputError) as caught:
        analyse(spoiled(lambda c, _: with_channel(c, 2, 0.1)))
    assert re.fullmatch(r"scope\.csv:2: [^\n]+", str(caught.value))


@pytest.mark.parametrize(
    ("lags", "words"),
    [
        ((2.0, 120.0), "channels 1 and 2 show the same"),
        ((120.0, 358.0), "channels 1 and 3 show the same"),
        ((240.0, 243.0), "channels 2 and 3 show the same"),
        ((120.0, 60.0), "the wrong way round"),
        ((90.0, 200.0), "what the probes were connected to"),
    ],
)
def test_three_channels_that_are_no_phases_are_told_why(
    lags: tuple[float, float], words: str
) -> None:
    phasors = np.exp(-1j * np.radians([0.0, *lags]))
    with pytest.raises(InputError, match=words):
        check_displacements(phasors, Origin("three.csv", np.array([], dtype=np.intp)))
