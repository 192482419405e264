"""The pulses that tell north from south, from the saturation of the flux map.

Where the d axis saturates like L_dd(i) = L_d (1 - s i/I), equal volt-seconds to +-I_p leave peaks
that differ by D = s I_p^2/I. Noise of sigma per sample decides wrongly with probability
Q(D sqrt(n/2)/sigma) over n pairs. D is taken from the map itself, s is what it means at the largest
current.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.saliency.injection import current_noise
from dqforge.optimizer.saliency.polarity_steps import PolarityGains

WRONG = 1e-4  # Largest probability of a wrong decision.
VISIBLE = 5.0  # Least s I over the noise of a sample.
_MOST_PULSES = 16
_STEPS = 40


@dataclass(frozen=True, slots=True)
class PolarityPlan:
    """The pulses and what they promise.

    ``i_peak`` in A; ``saturation`` is s; ``difference`` in A is that of both peaks, ``sigma`` in A
    the noise of a sample, ``wrong`` the probability of a wrong decision; ``duration`` in s.
    """

    gains: PolarityGains
    i_peak: float
    saturation: float
    difference: float
    sigma: float
    wrong: float
    duration: float


def wrong_decision(difference: float, sigma: float, pulses: int) -> float:
    """Probability of taking south for north.

    Args:
        difference: Of both peaks in A.
        sigma: Noise of a sample in A.
        pulses: Pairs of pulses whose sum decides.
    """
    return 0.5 * math.erfc(difference * math.sqrt(0.5 * pulses) / sigma / math.sqrt(2.0))


def peak_difference(machine: Machine, i_peak: float) -> float:
    """By how much the peak along the magnet exceeds that against it, in A, after equal volt-seconds
    that make ``i_peak`` in A against it or ``i_peak`` along it, whichever is the larger.

    Negative where the larger is the one against the magnet; 0 without saturation.
    """
    grid = np.linspace(-i_peak, i_peak, 2 * _STEPS + 1)
    none = np.zeros_like(grid)
    if not np.all(machine.known(grid, none)):
        grid = grid[machine.known(grid, none)]
        none = np.zeros_like(grid)
    flux = machine.flux(grid, none)[0]
    flux = flux - np.interp(0.0, grid, flux)
    # the volt-seconds that both directions reach with at most i_peak
    most = min(flux[-1], -flux[0])
    along, against = (float(np.interp(x, flux, grid)) for x in (most, -most))
    return along + against


def plan_polarity(design: Design) -> PolarityPlan:
    """The smallest current and the fewest pulses that decide wrongly once in 10,000 at most.

    Raises:
        NoSolutionError: The d axis saturates too little to be seen; the message has the numbers.
    """
    machine, i_max = design.machine, design.i_max
    sigma, t_s = current_noise(design), design.control.t_s
    saturation = abs(peak_difference(machine, i_max)) / i_max
    if saturation * i_max < VISIBLE * sigma:
        raise NoSolutionError(
            "control.observer: the polarity of the magnet does not show: the d axis saturates by "
            f"s = {saturation:.3g} at {i_max:.4g} A, so that opposite pulses differ by "
            f"{saturation * i_max:.3g} A, and {VISIBLE * sigma:.3g} A (five times the noise of a "
            "sample) are needed; write a flux map that has the saturation, or align the rotor first"
        )
    for pulses in (1, 2, 4, 8, _MOST_PULSES):
        for i_peak in np.linspace(0.1, 1.0, 19) * i_max:
            difference = peak_difference(machine, float(i_peak))
            if wrong_decision(abs(difference), sigma, pulses) <= WRONG:
                return _plan(design, float(i_peak), pulses, difference, saturation)
    raise NoSolutionError(
        f"control.observer: {_MOST_PULSES} pairs of pulses of {i_max:.4g} A tell north from south "
        f"wrongly with {wrong_decision(saturation * i_max, sigma, _MOST_PULSES):.2g}, {WRONG:g} is "
        f"permitted; {t_s:g} s per sample and {sigma:.3g} A of noise leave no more"
    )


def _plan(
    design: Design, i_peak: float, pulses: int, difference: float, saturation: float
) -> PolarityPlan:
    t_s, sigma = design.control.t_s, current_noise(design)
    most = 0.5 * design.inverter.v_dc / math.sqrt(3.0)
    seconds = linearised(design.machine).l_d * i_peak
    periods = max(1, math.ceil(seconds / (most * t_s)))
    gains = PolarityGains(
        voltage=seconds / (periods * t_s),
        periods=float(periods),
        pause=float(4 + periods),
        pulses=float(pulses),
        sign=1.0 if difference > 0.0 else -1.0,
    )
    return PolarityPlan(
        gains=gains,
        i_peak=i_peak,
        saturation=saturation,
        difference=abs(difference),
        sigma=sigma,
        wrong=wrong_decision(abs(difference), sigma, pulses),
        duration=2.0 * pulses * (2.0 * periods + gains.pause) * t_s,
    )
