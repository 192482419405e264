"""Back-EMF as an oscilloscope, or a finite-element program, recorded it:
from samples to harmonics per speed.

Convention: theta is the electrical angle of the d axis from phase a, and

    e_k / omega_e = - sum_h A_kh sin(h theta - phi_kh),
        psi_k = sum_h (A_kh / h) cos(h theta - phi_kh),

so that phi is the phase of the magnet's flux linkage and an ideal machine has phi_1 = 0, 120 and
-120 degrees in phases a, b and c. The d axis lies along the positive sequence of the fundamental:
that is how the angle is aligned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf import checks
from dqforge.machines.back_emf import harmonics as motions
from dqforge.machines.back_emf import harmonics as numerics
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.back_emf.columns import (
    BemfCapture,
    BemfResult,
    periods_of,
    pole_pairs_of_fit,
    result_of_fit,
)
from dqforge.machines.back_emf.harmonics import (
    ComplexArray,
    HarmonicFit,
    Motion,
    covers_turn,
    fit_pole_pairs,
)

_COARSE_HARMONICS = 7


_COARSE_SAMPLES = (
    100.0  # to the period: harmonics that they fold onto the first seven are of order 93 and more
)


# e_a = (e_ab - e_ca) / 3 and so on: phase voltages without zero sequence.
_TO_PHASES = (np.eye(3) - np.roll(np.eye(3), -1, axis=1)) / 3.0


def analyse(
    capture: BemfCapture,
    *,
    pole_pairs: int | None = None,
    speed: float | None = None,
    harmonics: int = 25,
    progress: Callable[[float], None] | None = None,
) -> BemfResult:
    """Harmonics of the back-EMF per electrical speed, with their uncertainty,
    and what is peculiar about the capture.

    Args:
        capture: The samples.
        pole_pairs, speed: Number of pole pairs, with which the result says what they differ by, and
            mechanical speed in rad/s. Over the time both are a check only; over an angle they are
            what the voltages are divided by, and without them the values are taken for e / omega_e.
        harmonics: Highest order wanted; lowered, and said so, where there are less than 4 samples
            in its period.
        progress: Told the share that is done.

    Raises:
        InputError: The capture is not that of a turning three-phase machine, or speed and frequency
            contradict each other.
    """
    origin = Origin(capture.source, capture.lines)
    tell = progress or (lambda _: None)
    axis = checks.check_samples(capture.time, capture.angle, capture.voltages, origin)
    timed = capture.time is not None
    alone = capture.voltages.shape[0] == 1 and capture.connection == "line-to-line"
    if capture.voltages.shape[0] != 3 and not alone:
        raise origin.error(
            f"a three-phase capture needs three channels, got {capture.voltages.shape[0]}", None
        )
    checks.check_flat(capture.voltages, origin)
    findings: list[str] = []
    if timed:
        motion, samples = _found_motion(axis, capture.voltages, origin, findings, tell)
    else:
        motion, samples = _given_motion(axis, origin)
    count = _orders_resolved(harmonics, samples, findings)
    motion, start = _coarse_fit(capture, motion, samples, count, origin)
    tell(0.3)
    voltages = capture.voltages
    if capture.connection == "line-to-line":
        findings += _line_to_line_findings(voltages)
        if not alone:
            voltages, start = _TO_PHASES @ voltages, _TO_PHASES @ start
    fit = numerics.fit_harmonics(
        motion, voltages, count, start, lambda share: tell(0.3 + 0.6 * share)
    )
    checks.check_condition(fit, origin)
    checks.check_length(periods_of(fit.motion), samples, origin)
    fit = _phase_of_wires(fit) if alone else fit
    if timed:
        checks.check_speed(fit.motion.frequency, pole_pairs, speed, origin)
        omega = fit.motion.unit_speed
    else:
        omega = _speed_of_angle(capture, pole_pairs, speed, origin, findings)
    steps = np.array([numerics.resolution(row) for row in capture.voltages]) * timed
    result = result_of_fit(
        fit, omega, steps, capture.connection, capture.quantity, findings, origin
    )
    turns = 1 if pole_pairs is None else pole_pairs
    if alone or turns == 1 or not covers_turn(fit.motion, result.periods, turns):
        return result
    whole = fit_pole_pairs(fit.motion, voltages, result.periods, turns, count)
    pairs = pole_pairs_of_fit(whole, omega, steps, capture.quantity, result, turns)
    return replace(result, pole_pairs=pairs)


def _phase_of_wires(fit: HarmonicFit) -> HarmonicFit:
    """Harmonics of phase a from those of one voltage between two wires.

    Where b is a, 120 degrees later, e_ab has C_h (1 - exp(-j h 120 deg)) of C_h in phase a: sqrt(3)
    in size, and nothing of the orders that are multiples of three.
    """
    orders = np.arange(1, fit.coefficients.shape[1] + 1)
    share = 1.0 - np.exp(-2j * np.pi * orders / 3.0)
    seen = orders % 3 != 0
    own = np.where(seen, fit.coefficients / np.where(seen, share, 1.0), 0.0)
    scaled = {name: getattr(fit, name) / np.sqrt(3.0) for name in _SCALED}
    return replace(fit, coefficients=own, **scaled)


_SCALED = ("offsets", "residual", "noise", "deviation")


def _found_motion(
    time: FloatArray,
    voltages: FloatArray,
    origin: Origin,
    findings: list[str],
    tell: Callable[[float], None],
) -> tuple[Motion, float]:
    """Motion that voltages over the time in s, shape (N,), show, and how
    many samples make a period.
    """
    frequency, share = motions.rough_frequency(time, voltages)
    tell(0.1)
    checks.check_line(share, origin)
    samples = 1.0 / (frequency * motions.sample_interval(time))
    checks.check_length(time.size / samples, samples, origin)
    findings += checks.check_clipping(voltages, samples, origin)
    motion = motions.rough_motion(time, voltages, frequency)
    tell(0.2)
    return motion, samples


def _coarse_fit(
    capture: BemfCapture, motion: Motion, samples: float, count: int, origin: Origin
) -> tuple[Motion, ComplexArray]:
    """The motion with what disturbs it, and the first harmonics of the channels, shape (3, H):
    where the fit begins.

    A few samples of each period suffice for both, and for the checks of
    what kind of signal this is.
    """
    voltages = capture.voltages
    stride = max(1, int(samples / _COARSE_SAMPLES))
    thin = replace(origin, lines=origin.lines[::stride])
    coarse = numerics.fit_harmonics(
        motion.thinned(stride), voltages[:, ::stride], min(_COARSE_HARMONICS, count)
    )
    motion = replace(motion, powers=coarse.motion.powers)
    periods = periods_of(motion)
    checks.check_periodic(coarse, voltages[:, ::stride], thin.lines.size / periods, thin)
    checks.check_length(periods, voltages.shape[1] / periods, origin)
    if len(voltages) == 1:
        return motion, coarse.coefficients
    # A third channel that is nothing but the negative sum of the others would
    # hide which of them is wrong.
    derived = capture.connection == "line-to-line" and np.array_equal(
        voltages[2], -(voltages[0] + voltages[1])
    )
    fundamentals = coarse.coefficients[: 2 if derived else 3, 0]
    checks.check_ratios(fundamentals, origin)
    checks.check_displacements(fundamentals, origin)
    return motion, coarse.coefficients


def analyse_period(
    angle: FloatArray,
    emf: FloatArray,
    *,
    source: str,
    lines: NDArray[np.intp] | None = None,
    harmonics: int = 25,
) -> BemfResult:
    """Like `analyse` for one phase over the angle.

    The other two are taken for the same, 120 degrees later each.

    Args:
        angle, emf: Electrical angle in rad, may contain both ends of the period, and e_a / omega_e
            in V s/rad, shapes (N,).
        source, lines: File name and the line of each sample, for messages.
        harmonics: As in `analyse`.

    Raises:
        InputError: The samples do not cover a period, are not finite, or are all the same.
    """
    origin = Origin(source, np.arange(1, angle.size + 1) if lines is None else lines)
    checks.check_samples(None, angle, emf[None], origin)
    checks.check_flat(emf[None], origin)
    findings = [
        "One phase was given; the other two are taken for the same, displaced by 120 degrees."
    ]
    motion, samples = _given_motion(angle, origin)
    fit = numerics.fit_harmonics(motion, emf[None], _orders_resolved(harmonics, samples, findings))
    checks.check_condition(fit, origin)
    checks.check_periodic(fit, emf[None], emf.size, origin)
    return result_of_fit(fit, 1.0, np.zeros(1), "phase", "voltage", findings, origin)


def _given_motion(angle: FloatArray, origin: Origin) -> tuple[Motion, float]:
    """Motion of a recorded angle in rad, shape (N,), and how many of its
    largest gap make a period.
    """
    turned = np.sort(np.mod(angle, 2.0 * np.pi))
    gap = float(np.max(np.diff(np.concatenate([turned, turned[:1] + 2.0 * np.pi]))))
    checks.check_coverage(gap, origin)
    return Motion(np.zeros_like(angle), 1.0, 1.0, np.zeros(0), angle), 2.0 * np.pi / gap


def _orders_resolved(harmonics: int, samples: float, findings: list[str]) -> int:
    """Highest order that has 4 (to 1 %) of a period's ``samples`` in its own;
    a finding if that is less than wanted.
    """
    resolved = max(1, int(1.01 * samples / 4.0))
    if resolved < harmonics:
        findings.append(
            f"{samples:.0f} samples in a period resolve harmonics up to order {resolved}, not "
            f"{harmonics} as wanted."
        )
    return min(resolved, harmonics)


def _line_to_line_findings(voltages: FloatArray) -> list[str]:
    """Say what line-to-line voltages cannot tell, and whether the three add to zero."""
    findings = [
        (
            "Line-to-line voltages do not contain the zero sequence: harmonics of order 3, 6, 9, "
            "... are unknown."
        )
    ]
    if len(voltages) == 1:
        findings.append(
            "One voltage between two wires was given: the phases are taken for equal and 120 "
            "degrees apart; how far they differ is unknown."
        )
        return findings
    share = float(np.std(np.sum(voltages, axis=0)) / np.mean([np.std(row) for row in voltages]))
    if share > 0.05:
        findings.append(
            f"The three line-to-line voltages add to {share:.0%} of one of them instead of 0; are "
            "they phase voltages?"
        )
    return findings


def _speed_of_angle(
    capture: BemfCapture,
    pole_pairs: int | None,
    speed: float | None,
    origin: Origin,
    findings: list[str],
) -> float:
    """Electrical speed in rad/s that values over an angle are divided by."""
    if capture.quantity == "flux":
        return 1.0
    if speed is None:
        findings.append(
            "No speed was given: the values over the angle are taken for e / omega_e in V s/rad."
        )
        return 1.0
    if pole_pairs is None or speed == 0.0:
        raise origin.error(
            "voltages over an angle need the number of pole pairs and a speed other than 0", None
        )
    return pole_pairs * speed
