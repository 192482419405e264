"""What is asked of a firmware in the tests: the e-scooter's hub, and machines drawn at random."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from drives import make_design

from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, drive_values

TWO_PI = 2.0 * math.pi

# 48 V, 60 rpm/V (line to line, peak), 100 mOhm and 200 uH line to line, 15 pole pairs, 40 A rms.
SCOOTER = LinearMachine(
    pole_pairs=15,
    r_s=0.05,
    l_d=1e-4,
    l_q=1e-4,
    psi_pm=60.0 / (math.sqrt(3.0) * TWO_PI * 15 * 60.0),
    i_max=40.0 * math.sqrt(2.0),
    inertia=0.02,
    omega_m_max=250.0,
)


def asked_of(
    machine: Machine,
    *,
    v_dc: float = 48.0,
    f_sw: float = 20e3,
    dead_time: float = 0.0,
    crossover: float = TWO_PI * 1000.0,
    speed: PiGains | None = None,
    ratio: int = 20,
    name: str = "test drive",
) -> Asked:
    """A design around a machine with gains by pole cancellation, as asked of a firmware."""
    made = make_design(SCOOTER, name=name, prefix="scooter")
    control = replace(
        made.control,
        t_s=1.0 / f_sw,
        speed_loop=None
        if speed is None or made.control.speed_loop is None
        else replace(made.control.speed_loop, ratio=ratio),
    )
    design = replace(
        made,
        machine=machine,
        inverter=Inverter(v_dc, f_sw, dead_time=dead_time),
        control=control,
    )
    return Asked(
        design,
        drive_values(design),
        PiGains(crossover * machine.l_d, crossover * machine.r_s),
        PiGains(crossover * machine.l_q, crossover * machine.r_s),
        speed,
    )


def scooter(*, with_speed: bool = True, dead_time: float = 500e-9) -> Asked:
    """The e-scooter's hub with a speed loop of 100 rad/s."""
    constant = 1.5 * SCOOTER.pole_pairs * SCOOTER.psi_pm
    kp = 100.0 * 0.02 / constant
    speed = PiGains(kp, kp * 100.0 / 4.0) if with_speed else None
    return asked_of(SCOOTER, speed=speed, dead_time=dead_time)


def random_asked(count: int, seed: int = 20) -> Iterator[Asked]:
    """Machines from a gimbal's to a truck's, salient ones among them, half with a speed loop."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    for index in range(count):
        l_d = between(5e-6, 1e-2)
        machine = LinearMachine(
            pole_pairs=int(rng.integers(1, 25)),
            r_s=between(1e-3, 5.0),
            l_d=l_d,
            l_q=l_d * float(rng.choice([1.0, between(0.7, 4.0)])),
            psi_pm=between(5e-4, 0.5),
            i_max=between(1.0, 600.0),
            inertia=between(1e-6, 1.0),
            omega_m_max=between(20.0, 2000.0),
        )
        f_sw = between(8e3, 60e3)
        speed = PiGains(between(1e-3, 50.0), between(1e-2, 500.0)) if index % 2 else None
        yield asked_of(
            machine,
            v_dc=between(12.0, 800.0),
            f_sw=f_sw,
            dead_time=float(rng.choice([0.0, between(1e-7, 3e-6)])),
            crossover=f_sw * between(0.02, 0.5),
            speed=speed,
            ratio=int(rng.integers(1, 40)),
            name=f"drive {index}",
        )


def numbers_of(sentences: Iterable[str], words: str) -> list[float]:
    """The numbers of the one sentence that has these words."""
    (text,) = [sentence for sentence in sentences if words in sentence]
    found = re.findall(r"(?<![\w.])-?\d[\d.]*(?:e[-+]?\d+)?", text)
    return [float(number.rstrip(".")) for number in found]
