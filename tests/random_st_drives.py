"""Random drives for the tests of ST's MCSDK: machines of all sizes, each with a fitting shunt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, drive_values


def base_design() -> Design:
    """A small servo drive of the library with a shunt of 10 mOhm and a gain of 5.18."""
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    sensing = "  current_sensing: {shunt: 10 mOhm, gain: 5.18, reference: 3.3 V}\n  v_dc:"
    assert text.count("\n  v_dc:") == 1
    return load_text(text.replace("\n  v_dc:", "\n" + sensing).encode(), "d.yaml")


def value(found: Configuration, name: str) -> float:
    """A number of a configuration by its own name."""
    stated = found.own[name]
    assert not isinstance(stated, str)
    return float(stated)


def random_asked(count: int, seed: int, *, tables: int = 0) -> Iterator[Asked]:
    """What random drives ask of the MCSDK; the first few with a table of currents.

    Args:
        count: How many.
        seed: Of the random numbers.
        tables: How many of them are to use the reluctance torque.
    """
    base, rng = base_design(), np.random.default_rng(seed)
    for index in range(count):
        yield _asked(base, rng, table=index < tables)


def _asked(base: Design, rng: np.random.Generator, *, table: bool) -> Asked:
    i_max, v_dc = 10.0 ** rng.uniform(0.0, 2.5), 10.0 ** rng.uniform(1.1, 2.8)
    base_speed = 10.0 ** rng.uniform(2.0, 3.3)
    psi = 0.4 * v_dc / base_speed
    l_d = psi / i_max * 10.0 ** rng.uniform(-1.5, 0.0)
    l_q = l_d * (rng.uniform(1.5, 3.0) if table else 10.0 ** max(0.0, rng.uniform(-0.3, 0.5)))
    f_sw = float(rng.choice([8e3, 10e3, 16e3, 20e3, 40e3, 100e3]))
    pairs = int(rng.integers(1, 12))
    machine = LinearMachine(
        pole_pairs=pairs,
        r_s=0.05 * v_dc / i_max * 10.0 ** rng.uniform(-1.0, 0.5),
        l_d=l_d,
        l_q=l_q,
        psi_pm=psi,
        i_max=i_max,
        omega_m_max=base_speed / pairs,
        inertia=10.0 ** rng.uniform(-6.0, -1.0),
        friction=float(rng.choice([0.0, 1e-5])),
    )
    room = 20.0 if table else 1.1 * 10.0 ** rng.uniform(0.0, 1.0)
    slope = 1.65 / (i_max * room)
    gain = float(rng.choice([1.53, 5.18, 9.14, 20.0]))
    sensing = CurrentSensing(float(f"{slope / gain:.4g}"), gain, 3.3)
    inverter = replace(base.inverter, v_dc=v_dc, f_sw=f_sw, current_sensing=sensing)
    control = replace(base.control, t_s=float(rng.choice([1.0, 2.0])) / f_sw)
    operation = replace(base.operation, strategy="mtpa" if table else "id0")
    design = replace(base, machine=machine, inverter=inverter, control=control, operation=operation)
    bandwidth = 10.0 ** rng.uniform(-1.5, -0.7) / control.t_s
    d = PiGains(l_d * bandwidth, machine.r_s * bandwidth)
    q = PiGains(l_q * bandwidth, machine.r_s * bandwidth)
    crossover = 0.05 * bandwidth
    constant = 1.5 * pairs * psi
    inertia = machine.inertia or 1.0
    kp = min(crossover * inertia / constant, 0.1 * i_max)
    speed = PiGains(kp, 0.2 * crossover * kp) if rng.uniform() < 0.7 else None
    return Asked(design, drive_values(design), d, q, speed)
