"""Named PI tuning methods: their formulas, and what each can be asked to do
when its loop does not hold.

Formulas are the common ones of drive practice (docs/methods/current-and-speed-loops.md has the
sources);
nothing here knows the sampled loop. `dqforge.optimizer.loops.gains` checks the gains on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.loops.vendor_methods import is_vendor, vendor_current_pi, vendor_speed_pi

Settings = TypeVar("Settings", CurrentLoopSettings, SpeedLoopSettings)


CURRENT_DELAY = 1.5  # sampling periods: one of computation, half of one from the zero-order hold


SEARCH_HALVINGS = 40


SEARCH_BISECTIONS = 14  # the factor is then known to better than the three digits that are printed


def required_setting(value: float | None, key: str, method: str) -> float:
    """Return a setting that the method cannot do without.

    Args:
        value: The setting, None where it is not given.
        key: Its key in the design file.
        method: The method, for the message.
    """
    if value is None:
        raise InputError(f"{key} is missing: method '{method}' needs it")
    if not (value > 0.0 and np.isfinite(value)):
        raise InputError(f"{key} must be positive and finite, got {value:g}")
    return value


def current_pi(
    r_s: float, inductance: float, t_s: float, settings: CurrentLoopSettings
) -> tuple[float, float]:
    """Gains (kp in V/A, ki in V/(A s)) of one axis, before any check of the loop.

        bandwidth            kp = w L             ki = w R
                             (pole cancelled; w crossover without delay)
        damping              kp = 2 xi w L - R    ki = w^2 L
                             (poles of s^2 + 2 xi w s + w^2)
        magnitude-optimum    kp = L/(2 T)         ki = kp R/L            T = 1.5 t_s
        symmetrical-optimum  kp = L/(a T)         ki = kp/(a^2 T)        T = 1.5 t_s, spread a

    and the rules of vendors, `dqforge.optimizer.loops.vendor_methods`.

    ``r_s`` in Ohm, ``inductance`` in H, ``t_s`` in s.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        settings: Method and its settings.
    """
    method, key, t_sum = settings.method, "control.current_loop", CURRENT_DELAY * t_s
    if method == "given":
        return required_setting(settings.kp, f"{key}.kp", method), required_setting(
            settings.ki, f"{key}.ki", method
        )
    if method == "magnitude-optimum":
        kp = inductance / (2.0 * t_sum)
        return kp, kp * r_s / inductance
    if method == "symmetrical-optimum":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        kp = inductance / (spread * t_sum)
        return kp, kp / (spread**2 * t_sum)
    omega = required_setting(settings.bandwidth, f"{key}.bandwidth", method)
    if method == "bandwidth":
        return omega * inductance, omega * r_s
    if is_vendor(method):
        return vendor_current_pi(method, r_s, inductance, omega, settings.damping)
    damping = required_setting(settings.damping, f"{key}.damping", method)
    return 2.0 * damping * omega * inductance - r_s, omega**2 * inductance


def speed_pi(
    inertia: float, friction: float, t_sum: float, settings: SpeedLoopSettings
) -> tuple[float, float]:
    """Gains (kp in N m s/rad, ki in N m/rad) of the speed loop, before any check of the loop.

        bandwidth            kp = w J             ki = kp w/4
        damping              kp = 2 xi w J - B    ki = w^2 J
                             (poles of s^2 + 2 xi w s + w^2)
        symmetrical-optimum  kp = J/(a T)         ki = kp/(a^2 T)        T = t_sum, spread a

    Rules of vendors are those of `dqforge.optimizer.loops.vendor_methods`; for ti ``t_sum`` is one
    over the bandwidth of the current loop. With ki = kp w/4 and B = 0 the loop without delays has
    the double pole s^2 + w s + w^2/4 = (s + w/2)^2: the fastest integral action that leaves the
    poles real.

    Args:
        inertia, friction: J in kg m^2, B in N m s/rad.
        t_sum: Sum of the small delays in s, see `speed_delay`.
        settings: Method and its settings.
    """
    method, key = settings.method, "control.speed_loop"
    if method == "given":
        return required_setting(settings.kp, f"{key}.kp", method), required_setting(
            settings.ki, f"{key}.ki", method
        )
    if method == "symmetrical-optimum":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        kp = inertia / (spread * t_sum)
        return kp, kp / (spread**2 * t_sum)
    if method == "ti":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        return vendor_speed_pi(method, (inertia, friction), 1.0 / t_sum, 1.0, spread)
    omega = required_setting(settings.bandwidth, f"{key}.bandwidth", method)
    if is_vendor(method):
        return vendor_speed_pi(method, (inertia, friction), omega, settings.damping, 1.0)
    if method == "bandwidth":
        return omega * inertia, 0.25 * omega**2 * inertia
    damping = required_setting(settings.damping, f"{key}.damping", method)
    return 2.0 * damping * omega * inertia - friction, omega**2 * inertia


def require_positive(
    key: str,
    loop: str,
    settings: CurrentLoopSettings | SpeedLoopSettings,
    gains: tuple[float, float],
    rate: float,
) -> None:
    """Refuse gains that are not positive and finite; ``rate`` in rad/s is R/(2 L) or B/(2 J).

    Args:
        key: Section of the design file, for the message.
        loop: Which loop, for the message.
        settings: Method and its settings.
        gains: kp and ki.
        rate: Rate of decay in rad/s that the loop must exceed: R/(2 L) or B/(2 J).
    """
    kp, ki = gains
    if kp > 0.0 and ki > 0.0 and np.isfinite(kp) and np.isfinite(ki):
        return
    reached = (
        f"{key}: method '{settings.method}' gives the {loop} loop kp = {kp:.4g} and ki = {ki:.4g}"
    )
    if settings.method in ("damping", "nxp-mcat") and kp <= 0.0:
        least = rate / settings.damping
        raise NoSolutionError(
            f"{reached}; kp is positive from {key}.bandwidth above {_rate_text(least, up=True)}"
        )
    raise NoSolutionError(
        f"{reached}; both must be positive and finite: use another method, or check the machine"
    )


def by_spread(settings: CurrentLoopSettings | SpeedLoopSettings) -> bool:
    """Whether a method's number is its spread: the symmetrical optimum, and TI's speed loop.

    Args:
        settings: Method and its settings.
    """
    of_ti = settings.method == "ti" and isinstance(settings, SpeedLoopSettings)
    return settings.method == "symmetrical-optimum" or of_ti


def calmer(settings: Settings, factor: float) -> Settings:
    """Make the same settings ask for a calmer loop (factor below one)."""
    if settings.method == "given":
        kp, ki = (
            required_setting(settings.kp, "kp", "given"),
            required_setting(settings.ki, "ki", "given"),
        )
        return replace(settings, kp=kp * factor, ki=ki * factor)
    if by_spread(settings):
        return replace(settings, spread=settings.spread / factor)
    if settings.method == "optimised":
        return replace(settings, max_sensitivity=1.0 + (settings.max_sensitivity - 1.0) * factor)
    return replace(
        settings,
        bandwidth=required_setting(settings.bandwidth, "bandwidth", settings.method) * factor,
    )


def largest_factor(holds: Callable[[float], bool]) -> float | None:
    """Largest factor below one for which the loop holds, to three digits on the safe side,
    or None.
    """
    high, low = 1.0, 0.5
    for _ in range(SEARCH_HALVINGS):
        if holds(low):
            break
        high, low = low, 0.5 * low
    else:
        return None
    for _ in range(SEARCH_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _three_digits(value: float, *, up: bool) -> float:
    """Three significant digits, rounded up or down."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    rounded = np.ceil(value / unit - 1e-9) if up else np.floor(value / unit + 1e-9)
    return float(rounded * unit)


def _rate_text(omega: float, *, up: bool) -> str:
    rounded = _three_digits(omega, up=up)
    return f"{rounded:.6g} rad/s ({rounded / (2.0 * np.pi):.3g} Hz)"


def loop_advice(key: str, settings: CurrentLoopSettings | SpeedLoopSettings, factor: float) -> str:
    """Say what to write for a loop that holds, given the factor from `largest_factor`.

    Args:
        key: Key of the design file whose value does not hold.
        settings: Method and its settings.
        factor: Factor by which all gains may grow at most.
    """
    if settings.method == "given":
        return f"multiply {key}.kp and {key}.ki by {_three_digits(factor, up=False):.6g} or less"
    if by_spread(settings):
        return (
            f"it holds from {key}.spread = {_three_digits(settings.spread / factor, up=True):.6g} "
            "upwards"
        )
    if settings.method == "optimised":
        largest = 1.0 + _three_digits((settings.max_sensitivity - 1.0) * factor, up=False)
        return f"it holds from {key}.max_sensitivity = {largest:.6g} downwards"
    limit = _rate_text(
        required_setting(settings.bandwidth, "bandwidth", settings.method) * factor, up=False
    )
    return f"method '{settings.method}' holds up to {key}.bandwidth = {limit}"
