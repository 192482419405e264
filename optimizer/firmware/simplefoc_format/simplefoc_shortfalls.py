"""What SimpleFOC's motor cannot hold of a design, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.common_shortfalls import q_current_alone
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.profile import LoopProfile


def shortfalls(asked: Asked, held: Configuration, runs: LoopProfile) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
        runs: The loops that the library runs with it.
    """
    return (*_currents(asked, held), *_back_emf(asked, runs), *_loop(held), *_filter(asked, runs))


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    psi = held.drive.psi_pm
    if psi is None:
        return
    lead = "SimpleFOC commands no d current"
    tail = ", unless the sketch sets feed_forward_current.d in every loop"
    yield from q_current_alone(asked, psi, lead, tail=tail)


def _back_emf(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    drive = asked.drive
    if runs.current.back_emf or not drive.omega_m_max or not drive.pole_pairs or not drive.psi_pm:
        return
    volts = drive.omega_m_max * drive.pole_pairs * drive.psi_pm
    yield Shortfall(
        f"the integral of the q current holds the whole back-EMF, {volts:.4g} V at the largest "
        f"speed: it is not fed forward with both currents controlled",
        (Price("voltage in the integral", volts, "V"),),
    )


def _loop(held: Configuration) -> Iterator[Shortfall]:
    period = held.drive.t_s
    if period:
        yield Shortfall(
            f"the library measures the period of its loop and holds none: call loopFOC() every "
            f"{1e6 * period:.4g} us from a timer; margins are those of that period"
        )


def _filter(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    if asked.speed is None or runs.speed is None:
        return
    filter_time, drive = runs.speed.feedback.filter_time, asked.drive
    if drive.inertia and drive.pole_pairs and drive.psi_pm and filter_time > 0.0:
        crossover = 1.5 * drive.pole_pairs * drive.psi_pm * asked.speed.kp / drive.inertia
        lag = math.atan(crossover * filter_time)
        yield Shortfall(
            f"the measured speed is filtered over {1e3 * filter_time:.3g} ms (LPF_velocity.Tf), "
            f"which takes {math.degrees(lag):.1f} deg at {crossover:.4g} rad/s",
            (Price("phase margin of the speed loop", lag, "rad"),),
        )
