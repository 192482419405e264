"""Full scales of an observer in integers, and gains between them."""

from __future__ import annotations

import math

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.fixed_observers.kit import ONE, TOP, WIDTH, FixedPll
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise
from dqforge.optimizer.observers.pll import PllGains

_FLUX_RESERVE = 1.5


@dataclass(frozen=True, slots=True)
class Scales:
    """Full scales: ``current`` in A, ``voltage`` in V, ``speed`` (electrical) in rad/s; ``t_s``
    in s; the machine for which the observer was made.
    """

    current: float
    voltage: float
    speed: float
    t_s: float
    machine: LinearMachine

    @property
    def turn(self) -> float:
        """Angle in rad by which the drive turns in a period at full scale of the speed."""
        return self.t_s * self.speed

    @property
    def flux(self) -> float:
        """Full scale of flux linkages in V s: half as much again as magnet and largest current
        make together.
        """
        machine = self.machine
        inductance = max(machine.l_d, machine.l_q)
        return _FLUX_RESERVE * (machine.psi_pm + inductance * self.current)

    def emf(self, omega_max: float) -> float:
        """Full scale of EMFs in V: at least that of the voltage, and half as much again as the
        machine makes at ``omega_max`` rad/s.
        """
        machine = self.machine
        flux = machine.psi_pm + abs(machine.l_d - machine.l_q) * self.current
        return max(self.voltage, _FLUX_RESERVE * omega_max * flux)

    def pll(self, gains: PllGains) -> FixedPll:
        """A phase-locked loop in integers."""
        return FixedPll(
            advance=self.advance,
            l_1=gain("share of the angle error", gains.l_1 / math.pi),
            l_2=gain("speed of the angle error", gains.l_2 / self.speed),
        )

    @property
    def advance(self) -> FixedGain:
        """Codes of the angle of a period from codes of the speed."""
        return gain("angle of a period", self.turn / math.pi)


def gain(name: str, value: float, argument: int = ONE) -> FixedGain:
    """A gain between codes.

    Args:
        name: What it is, for the message.
        value: The gain.
        argument: Largest magnitude of what it is multiplied with.

    Raises:
        NoSolutionError: No format of 32 bits holds it.
    """
    try:
        return quantise(value, WIDTH, argument)
    except NoSolutionError as error:
        raise NoSolutionError(f"fixed point: observer, {name}: {error}") from None


def code(name: str, share: float, one: int = ONE) -> int:
    """Code of a share of full scale.

    Raises:
        NoSolutionError: It is beyond full scale.
    """
    found = round(share * one)
    if abs(found) > TOP:
        raise NoSolutionError(
            f"fixed point: observer, {name} is {share:.4g} of full scale; use larger bases in "
            "control.per_unit"
        )
    return found


def size_floor(share: float) -> int:
    """Code of 16 bits of a least length, for `kit.sine_of_angle`; at least one."""
    return max(1, round(share * 2**15))


def speed_limit(omega: float, scales: Scales) -> int:
    """Code of a speed limit in rad/s, at most full scale."""
    limit: int = min(TOP, round(omega / scales.speed * ONE))
    return limit
