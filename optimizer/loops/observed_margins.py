"""What is known of a speed loop that runs on an observer: its margins over the speed,
and what the observer leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.loops.plants import PiLoop


@dataclass(frozen=True, slots=True, eq=False)
class ObservedLoop:
    """A speed loop with the lag of its observer, at S electrical speeds in rad/s.

    Arrays of shape (S,).

    Parameters
    ----------
    observer:
        The method, in words.
    omega, crossover, phase_margin, radius:
        Speeds, gain crossovers in rad/s, phase margins in rad, largest moduli
        of the closed loop's poles.
    worst:
        Index of the speed that counts: unstable, or with the least margin.
    loop:
        The loop there.
    required:
        Phase margin in rad that the design asks for.
    left:
        Crossover in rad/s that the observer leaves: the fastest loop of the same shape that is
        stable and has the required margin at all speeds. The loop's own where it has; None where no
        slower one has.
    advice:
        What to write for that loop; empty where the loop itself holds.
    """

    observer: str
    omega: FloatArray
    crossover: FloatArray
    phase_margin: FloatArray
    radius: FloatArray
    worst: int
    loop: PiLoop
    required: float
    left: float | None
    advice: str

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every speed."""
        return bool((self.radius < 1.0).all())

    @property
    def holds(self) -> bool:
        """Whether the loop has the required margin at every speed."""
        return self.stable and bool((abs(self.phase_margin) >= self.required).all())
