"""Fuzzy and neural estimators of resistance and magnet flux linkage beside the gates of
`online_estimation`, sought alike and tried on other drives.

All move both estimates by what the voltage has beside them, the resistance along the current, the
flux linkage along q, each with a trust of 0 to 1 that follows from speed and current:

    gates   1 where the current reaches n_0 and the speed stays below n_1 times it; of the flux
            linkage where the speed reaches n_2 + n_3 times the current; else 0
    fuzzy   25 rules of Sugeno for each trust, as of the speed controllers
    neural  a half and four neurons for each

Chapter 7.2.8 of paper 001 names estimators of parameters without a design; sets, layers, drives and
criterion are chosen here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from learned_speed import (
    HIDDEN,
    SETS,
    Change,
    fuzzy_change,
    instructions,
    neural_change,
    sought,
)
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import OnlineEstimationSettings
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.online_estimation import gains_of, left_of_dead_time
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic

BENCH = "paper001-pmsm-bench"
LEARNED, OTHERS = 48, 400  # Drives.
_LEVELS, _HELD = 16, 20  # Operating points of a drive, and steps at each.
_STEP = 0.1  # Share of a gap that a step closes with a trust of 1.
_SLOW = 1.0  # rad/s: below, a flux linkage is not worked out
_WARM, _COLD = 0.35, -0.1  # Of the resistance, and of the flux linkage, at the end.


# The trusts, from speed and current as shares of their largest, each moved to -1 to 1.


def _shares(o: Arithmetic, speed: Reals, current: Reals) -> tuple[Reals, Reals]:
    return o.let("s", 0.5 + 0.5 * speed), o.let("c", 0.5 + 0.5 * current)


def resistance_gate(o: Arithmetic, numbers: Sequence[Any], speed: Reals, current: Reals) -> Reals:
    """1 where the current is large and the speed small against it."""
    s, c = _shares(o, speed, current)
    low = o.choose(s <= o.at(numbers, 1) * c, o.full(1.0, s), o.full(0.0, s))
    return o.choose(c >= o.at(numbers, 0), low, o.full(0.0, s))


def flux_gate(o: Arithmetic, numbers: Sequence[Any], speed: Reals, current: Reals) -> Reals:
    """1 where the speed is large against the current."""
    s, c = _shares(o, speed, current)
    least = o.multiply_add(o.at(numbers, 1), c, o.at(numbers, 0))
    return o.choose(s >= least, o.full(1.0, s), o.full(0.0, s))


def _bounded(o: Arithmetic, trust: Reals) -> Reals:
    own = o.let("trust", trust)
    return o.choose(own > 1.0, 1.0, o.choose(own > 0.0, own, o.full(0.0, own)))


def fuzzy_trust(o: Arithmetic, numbers: Sequence[Any], speed: Reals, current: Reals) -> Reals:
    """By 25 rules."""
    return _bounded(o, fuzzy_change(o, numbers, speed, current))


def neural_trust(o: Arithmetic, numbers: Sequence[Any], speed: Reals, current: Reals) -> Reals:
    """A half and four neurons."""
    return _bounded(o, 0.5 + neural_change(o, numbers, speed, current))


# Drives that warm up at changing operating points.


@dataclass(frozen=True, slots=True)
class WarmDrives:
    """N drives of one machine.

    ``speed`` in rad/s (electrical) and ``current`` in A (i_d + j i_q), shape (N, levels), at each
    operating point; relative errors of both inductances and of the current sensors, and ``dead`` in
    V, the amplitude that a dead time takes or gives, shape (N,).
    """

    speed: FloatArray
    current: NDArray[np.complex128]
    l_d: FloatArray
    l_q: FloatArray
    sensor: FloatArray
    dead: FloatArray


def bench() -> Design:
    """The drive of the thesis with both estimated."""
    design = catalogue.load(BENCH)
    settings = OnlineEstimationSettings(flux=True, resistance=True, time_constant=1.0)
    return replace(design, control=replace(design.control, online_estimation=settings))


def omega_most(design: Design) -> float:
    """Largest electrical speed in rad/s."""
    assert design.machine.omega_m_max is not None
    return design.machine.pole_pairs * design.machine.omega_m_max


def warm_drives(design: Design, count: int, seed: int) -> WarmDrives:
    """Drives at levels of speed and current, many of them slow or little loaded, in the upper half
    of the speeds with a weakened field.
    """
    rng = np.random.default_rng(seed)
    size = (count, _LEVELS)
    speed = rng.uniform(0.0, 1.0, size) ** 2
    torque = rng.uniform(0.01, 0.9, size) ** 2 * rng.choice([-1.0, 1.0], size)
    weak = np.where(speed > 0.5, rng.uniform(0.0, 0.4, size), 0.0)
    return WarmDrives(
        speed=omega_most(design) * speed,
        current=design.i_max * (1j * torque - weak),
        l_d=rng.uniform(-0.1, 0.1, count),
        l_q=rng.uniform(-0.1, 0.1, count),
        sensor=rng.uniform(-0.01, 0.01, count),
        dead=left_of_dead_time(design) * rng.uniform(-1.0, 1.0, count),
    )


def missing(
    design: Design, plant: WarmDrives, level: int, warm: float
) -> tuple[NDArray[np.complex128], FloatArray]:
    """Voltage in V beside that of the design's inductances, and speed in rad/s, shape (N,): what
    resistance and flux linkage make at the share ``warm`` of the warming, and all other errors.
    """
    machine, omega, i = design.machine, plant.speed[:, level], plant.current[:, level]
    r_s, psi = machine.r_s * (1.0 + _WARM * warm), machine.psi_pm * (1.0 + _COLD * warm)
    seen = i * (1.0 + plant.sensor)
    left = machine.l_d * ((1.0 + plant.l_d) * i.real - seen.real)
    across = machine.l_q * ((1.0 + plant.l_q) * i.imag - seen.imag)
    lost = plant.dead * i / np.abs(i)
    return r_s * i + 1j * omega * (psi + left + 1j * across) + lost, omega


@dataclass(frozen=True, slots=True)
class ParameterRuns:
    """Mean relative errors of both estimates over those without any, shape (..., N)."""

    resistance: FloatArray
    flux: FloatArray

    @property
    def criterion(self) -> FloatArray:
        """Mean over the drives of both, and half of the worst."""
        cost = self.resistance + self.flux
        return np.asarray(np.mean(cost, axis=-1) + 0.5 * np.max(cost, axis=-1))


def run(
    trusts: tuple[Change, Change], numbers: FloatArray, design: Design, plant: WarmDrives
) -> ParameterRuns:
    """Estimate on each drive with each set of numbers, from the design's values on.

    Args:
        trusts: Of the resistance and of the flux linkage.
        numbers: Shape (K, S) or (K,); the first half is of the resistance.
        design: Of `bench`.
        plant: N drives.
    """
    own = np.asarray(numbers, dtype=np.float64).reshape(len(numbers), -1, 1)
    machine, half = design.machine, len(numbers) // 2
    first = np.array([machine.r_s, machine.psi_pm])[:, None, None]
    shape = (own.shape[1], plant.dead.size)
    found = np.broadcast_to(first, (2, *shape)).copy()
    off, still = np.zeros((2, *shape)), np.zeros((2, 1, shape[1]))
    for level in range(_LEVELS):
        seen = plant.current[:, level] * (1.0 + plant.sensor)
        at = (
            np.broadcast_to(2.0 * x - 1.0, shape)
            for x in (plant.speed[:, level] / omega_most(design), np.abs(seen) / design.i_max)
        )
        speed, current = at
        trust = np.array(
            [
                trusts[0](EXACT, tuple(own[:half]), speed, current),
                trusts[1](EXACT, tuple(own[half:]), speed, current),
            ]
        )
        for k in range(_HELD):
            warm = (level * _HELD + k) / (_LEVELS * _HELD - 1.0)
            volts, omega = missing(design, plant, level, warm)
            e = volts - found[0] * seen - 1j * omega * found[1]
            along = np.real(e * np.conj(seen)) / np.abs(seen) ** 2
            gaps = np.array([along, np.imag(e) / np.maximum(omega, _SLOW)])
            found = np.clip(found + _STEP * trust * gaps, 0.5 * first, 2.0 * first)
            true = first * (1.0 + np.array([_WARM, _COLD]) * warm)[:, None, None]
            off += np.abs(found / true - 1.0)
            still += np.abs(first / true - 1.0)
    return ParameterRuns(*(off / still))


def _criterion(
    trusts: tuple[Change, Change], design: Design, plant: WarmDrives, numbers: FloatArray
) -> FloatArray:
    return run(trusts, numbers, design, plant).criterion


# All three by the same search, and the table of the page.


def design_numbers(design: Design) -> FloatArray:
    """Numbers of both gates of the emitted step, as shares, shape (4,)."""
    gains, omega, most = gains_of(design), omega_most(design), design.i_max
    return np.array(
        [
            gains.square_least**0.5 / most,
            gains.resistive * most / omega,
            gains.omega_least / omega,
            gains.turning * most / omega,
        ]
    )


GATES = (resistance_gate, flux_gate)
Estimator = tuple[str, tuple[Change, Change], FloatArray]


def estimators(design: Design, learn: WarmDrives) -> Iterator[Estimator]:
    """Gates of the design, gates, rules and neurons that were sought from there, each with the same
    number of runs.

    Args:
        design: Of `bench`.
        learn: Drives that the search sees.
    """
    begin = design_numbers(design)
    yield "gates of the design", GATES, begin
    grid = np.linspace(-1.0, 1.0, SETS)
    speed, current = (x.ravel() for x in np.meshgrid(grid, grid, indexing="ij"))
    table = np.concatenate(
        [GATES[n](EXACT, tuple(begin[2 * n : 2 * n + 2]), speed, current) for n in range(2)]
    )
    # Neurons that begin along the speed: the resistance is seen at low ones, the flux at high ones.
    neurons = np.concatenate(
        [np.ravel([(sign / HIDDEN, 1.0, 0.3 * way) for way in (-1, 0, 0, 1)]) for sign in (-1, 1)]
    )
    for name, trusts, first in (
        ("gates, sought", GATES, begin),
        ("fuzzy", (fuzzy_trust, fuzzy_trust), table),
        ("neural", (neural_trust, neural_trust), neurons),
    ):
        found = sought(partial(_criterion, trusts, design, learn), first)
        yield name, trusts, found


def parameter_estimators() -> Iterator[tuple[str, ...]]:
    """Estimators of resistance and flux linkage on drives that the search did not see."""
    design = bench()
    learn, other = (warm_drives(design, count, count) for count in (LEARNED, OTHERS))
    yield (
        "estimator", "numbers", "instructions M4F", "R, mean / worst", "psi, mean / worst",
    )  # fmt: skip
    for name, trusts, numbers in estimators(design, learn):
        half = len(numbers) // 2
        cost = sum(
            instructions(trust, part)
            for trust, part in zip(trusts, (numbers[:half], numbers[half:]), strict=True)
        )
        found = run(trusts, numbers, design, other)
        yield (
            name,
            str(numbers.size),
            f"{cost:.0f}",
            *(f"{x.mean():.2f} / {x.max():.2f}" for x in (found.resistance, found.flux)),
        )
