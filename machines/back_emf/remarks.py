"""What the user of a sound capture should know: its symmetry, noise and drift."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

_NOTED = {
    "asymmetry": 0.03,
    "displacement": np.radians(2.0),
    "even": 0.01,
    "offset": 0.03,
    "noise": 0.05,
    "drift": 0.05,
}


@dataclass(frozen=True, slots=True)
class BemfSymmetry:
    """How far three phases are from three equal ones with equal poles.

    Args:
        amplitude: Largest difference of a phase's fundamental amplitude from the mean, over the
            mean.
        displacement: Largest deviation of a fundamental from its 120 degrees, in rad.
        even: Root of the sum of the squared even harmonics that exceed their uncertainty, over the
            fundamental, of the phase where it is largest.
        half_wave: Largest |f(theta) + f(theta + pi)| / 2 that these harmonics make, over the
            largest |f|: 0 if the half waves mirror each other.
    """

    amplitude: float
    displacement: float
    even: float
    half_wave: float


def remarks(
    symmetry: BemfSymmetry,
    offsets: FloatArray,
    noise: FloatArray,
    amplitudes: FloatArray,
    drift: float,
    unit: str,
) -> list[str]:
    """Sentences on what a user should know.

    Offsets, noise and fundamental amplitudes in one unit, shape (3,).
    """
    findings = []
    for phase, (offset, rms, amplitude) in enumerate(zip(offsets, noise, amplitudes, strict=True)):
        name = "abc"[phase]
        if abs(offset) > _NOTED["offset"] * amplitude:
            share = offset / amplitude
            findings.append(
                f"Phase {name} has an offset of {offset:.3g} {unit} ({share:+.1%} of its "
                "amplitude): removed."
            )
        if rms > _NOTED["noise"] * amplitude:
            findings.append(
                f"Phase {name} has {rms:.3g} {unit} r.m.s. ({rms / amplitude:.1%} of its "
                "amplitude) of noise."
            )
    if symmetry.amplitude > _NOTED["asymmetry"]:
        findings.append(
            f"The phases' amplitudes differ from their mean by up to {symmetry.amplitude:.1%}."
        )
    if symmetry.displacement > _NOTED["displacement"]:
        worst = float(np.degrees(symmetry.displacement))
        findings.append(f"The phases are not 120 degrees apart, but up to {worst:.1f} degrees off.")
    if symmetry.even > _NOTED["even"]:
        findings.append(
            f"Even harmonics make {symmetry.even:.1%} of the fundamental: north and south poles "
            "differ."
        )
    if abs(drift) > _NOTED["drift"]:
        findings.append(f"The speed changes by {drift:+.1%} over the capture: divided out.")
    return findings
