"""Drives drawn at random: machines with any back-EMF, what feeds them, their gains and a point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES, link_demand

# Equal phases with mirrored half waves, equal phases with even orders, and phases that differ.
BASE = "paper002-phase-waveforms"
NODES = 360
WINDINGS = ("odd", "odd", "odd", "even", "unlike")

# Frames and what is fed forward; None is the frame that the design chooses itself.
WISHES: tuple[tuple[CurrentFrame | None, Feedforward], ...] = (
    (None, "references"),
    (None, "references"),
    (None, "references"),
    ("dqx", "measured"),
    ("dqy", "references"),
    ("dq", "references"),
)


@dataclass(frozen=True, eq=False)
class RandomMachine:
    """A machine, how it is sampled and controlled, and a point of operation.

    Args:
        seed: The number that it was drawn by.
        machine: In phase quantities.
        winding: One of `WINDINGS`.
        t_s: Sampling period in s; the carrier's too.
        bandwidth: Of the current loops in rad/s.
        omega_e_max, omega_e: Electrical speeds in rad/s: the largest, and that of the point, of
            either sign.
        share: Torque over the largest that the current permits, of either sign.
        load: Voltage of the point over that of the link.
        swing: Peak to peak of a split link's midpoint at the point over the link voltage, as a
            rule.
        dead_time: In s, which the design leaves room for.
        wish: Frame and feedforward.
    """

    seed: int
    machine: PhaseMachine
    winding: str
    t_s: float
    bandwidth: float
    omega_e_max: float
    omega_e: float
    share: float
    load: float
    swing: float
    dead_time: float
    wish: tuple[CurrentFrame | None, Feedforward]


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def random_machine(seed: int) -> RandomMachine:
    """The machine of a number, always the same."""
    rng = np.random.default_rng([20261122, seed])
    winding = WINDINGS[seed % 5]
    t_s = (5e-5, 1e-4, 1.25e-4)[int(rng.integers(3))]
    least = _log(rng, 10.0, 100.0)
    samples = min(least * _log(rng, 1.0, 30.0), 800.0)
    omega_e_max = 2.0 * math.pi / (least * t_s)
    psi, i_max = _log(rng, 0.003, 0.5), _log(rng, 2.0, 200.0)
    # The zero sequence's inductance over that of the plane: from no coupling of phases to nearly
    # all of it; not so little that pulses alone would make the current limit in a neutral.
    ratio = _log(rng, max(0.03, 2.5 / least), 1.0)
    mutual = (ratio - 1.0) / (ratio + 2.0)
    plane = _log(rng, 3.5 / (least * ratio), max(4.0 / (least * ratio), 0.6)) * psi / i_max
    r_s = min(_log(rng, 0.005, 0.1) * omega_e_max * psi / i_max, plane / 1e-3)
    l_s = plane / (1.0 - mutual)
    orders, sizes, lags = _harmonics(rng, winding)
    machine = PhaseMachine.from_harmonics(
        orders, psi * sizes, lags, pole_pairs=int(rng.integers(1, 9)), r_s=r_s, l_s=l_s,
        m_s=mutual * l_s, i_max=i_max, angles=NODES,
    )  # fmt: skip
    beyond = rng.uniform() < 0.08
    return RandomMachine(
        seed=seed,
        machine=machine,
        winding=winding,
        t_s=t_s,
        bandwidth=float(rng.uniform(0.015, 0.05)) * 2.0 * math.pi / t_s,
        omega_e_max=omega_e_max,
        omega_e=2.0 * math.pi / (samples * t_s) * (1.0 if rng.uniform() < 0.8 else -1.0),
        share=float(rng.uniform(0.15, 1.0)) * (1.0 if rng.uniform() < 0.8 else -1.0),
        load=float(rng.uniform(1.02, 1.5) if beyond else rng.uniform(0.3, 0.93)),
        swing=_log(rng, 0.005, 0.08),
        dead_time=float(rng.uniform(0.0, 0.015)) * t_s,
        wish=WISHES[seed // 5 % 6],
    )


def _harmonics(rng: np.random.Generator, winding: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Orders, amplitudes over the fundamental's and phases of a back-EMF."""
    step = 1 if winding == "even" else 2
    top = int(rng.integers(3, 14))
    orders = np.array([1, *range(3 if step == 2 else 2, max(top, 3) + 1, step)])
    size = _log(rng, 0.01, 0.4) if rng.uniform() < 0.93 else float(rng.uniform(0.8, 1.6))
    sizes = size * rng.uniform(0.0, 1.0, orders.size) * 3.0 / np.maximum(orders, 3)
    sizes[orders % 2 == 0] *= 0.4
    sizes[0] = 1.0
    lags = np.where(orders == 1, 0.0, rng.uniform(0.0, 2.0 * math.pi, orders.size))
    if winding != "unlike":
        return orders, sizes, lags
    unlike = 1.0 + 0.25 * rng.uniform(-1.0, 1.0, (3, orders.size))
    thirds = 2.0 * math.pi / 3.0 * np.arange(3)[:, np.newaxis]
    lags = lags + thirds * orders + 0.1 * rng.standard_normal((3, orders.size))
    sizes = sizes * unlike
    # The d axis lies where the positive sequence of the fundamental has it.
    angle = np.angle(np.sum(sizes[:, 0] * np.exp(1j * (lags[:, 0] - thirds[:, 0]))))
    return orders, sizes, lags - orders * angle


@lru_cache(maxsize=1)
def _base() -> Design:
    return catalogue.load(BASE)


def random_design(drawn: RandomMachine, topology: Topology) -> Design:
    """The design of a machine on a topology, on a link that makes the point what it is drawn as."""
    base, machine = _base(), drawn.machine
    frame, feedforward = drawn.wish
    if frame == "dqy" and not TOPOLOGIES[topology].neutral:
        frame = "dqx"
    rule = TOPOLOGIES[topology]
    zero = rule.neutral and frame in (None, "dqy")
    v_dc = _demand(drawn, topology, zero=zero) / drawn.load
    capacitance = _charge(drawn) / (drawn.swing * v_dc) if rule.midpoint else None
    plane = machine.l_s - machine.m_s
    return replace(
        base,
        machine=LinearMachine(
            machine.pole_pairs, machine.r_s, plane, plane, machine.psi_pm, machine.i_max,
            inertia=1e-3, omega_m_max=drawn.omega_e_max / machine.pole_pairs,
        ),
        phase_machine=machine,
        inverter=Inverter(
            v_dc, 1.0 / drawn.t_s, topology=topology, dead_time=drawn.dead_time,
            midpoint_capacitance=capacitance,
        ),
        control=replace(
            base.control,
            t_s=drawn.t_s,
            current_loop=CurrentLoopSettings(
                "bandwidth", bandwidth=drawn.bandwidth, frame=frame, feedforward=feedforward
            ),
        ),
    )  # fmt: skip


def _currents(drawn: RandomMachine, *, zero: bool) -> FloatArray:
    """Phase currents of the point along the back-EMF in A, shape (3, N)."""
    flux = np.asarray(drawn.machine.flux)
    used = flux if zero else flux - np.mean(flux, axis=0)
    square = np.sum(used**2, axis=0)
    currents = used / np.maximum(square, 0.05 * np.max(square))
    return np.asarray(currents * (drawn.share * drawn.machine.i_max / np.max(np.abs(currents))))


def _demand(drawn: RandomMachine, topology: Topology, *, zero: bool) -> float:
    """Link voltage in V that the point asks for."""
    machine, currents = drawn.machine, _currents(drawn, zero=zero)
    orders = np.fft.rfftfreq(NODES, 1.0 / NODES)
    slope = np.fft.irfft(1j * orders * np.fft.rfft(currents, axis=1), n=NODES, axis=1)
    voltage = machine.r_s * currents
    voltage += drawn.omega_e * (machine.inductances @ slope + machine.flux)
    return float(link_demand(voltage, topology))


def _charge(drawn: RandomMachine) -> float:
    """Peak to peak of the charge through a neutral that shares the torque, in C."""
    neutral = np.sum(_currents(drawn, zero=True), axis=0)
    charge = np.cumsum(neutral - np.mean(neutral)) * 2.0 * math.pi / NODES
    return float(np.ptp(charge)) / abs(drawn.omega_e)
