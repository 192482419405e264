"""The control program of paper 001 in its own integers, compiled into the plant of the bench.

Listing and section 8.2 of the thesis give the integers; the C is ours. What the thesis leaves open:
the size of its sine table (256 entries a turn here), which angle 0x8000 is (its text says half a
turn, its own increment of the sine reference a whole one, and only that fits three pole pairs at 24
a count), a quotient by zero before the second line of the encoder, and the constant with which it
starts v_q (0 here).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    InverterModel,
    Profile,
    Scenario,
    constant,
)
from dqforge.machines.records import dataclass
from dqforge.reports.pages.templating import render
from dqforge.reports.simulation.compiled_plant import Simulator, simulate, simulator
from dqforge.reports.simulation.design_run import drive_of
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation

# Full scales of the program's codes of current in A and of speed in rpm.
PREFIX = "thesis"
BASE_CURRENT, BASE_RPM = 12.8, 6750.0
CLOCK = 29.4912e6  # Of the signal processor in Hz: 33.9 ns.

# Of the pulse-width modulation, up and down: 29.4912 MHz x 200 us / 2, its fraction dropped.
TIMER_PERIOD = 2949

# 2^20 / 6750 with its fraction dropped; 155.34 would be exact, so that references are 0.22 % low.
INVERSE_BASE = 155

# Of 32768 a turn and period: 2 Hz are 13.1, so that the sine reference has 1.98 Hz.
SINE_INCREMENT = 13
CONVERTER = CurrentSensor(bits=10, full_scale=6.4)  # 10 bits from -6.4 to 6.4 A.

# Angle by counts; the adapter times the lines by the exact speed, as the capture unit does.
ENCODER = Encoder(1024, speed="exact")
_SINE_ENTRIES = 256


@dataclass(frozen=True, slots=True)
class Constants:
    """Integers of the program: gains in Q10, Q10, Q10, Q15 and limits in Q15."""

    kp_w: int = 20000
    kih_w: int = 2500
    kp_iq: int = 136
    kih_iq: int = 26
    max_w: int = 32000
    max_iq: int = 13000

    def content(self) -> bytes:
        """Bytes of the structure in C."""
        return np.array(list(asdict(self).values()), dtype=np.int32).tobytes()


# As the listing's active line works it out: 32767 x 200e-6 x 3.967285 = 25.999 becomes 25; 26
# stands in the line beside it, which is a comment.
LISTED_LINE = Constants(kih_iq=25)


def reference_code(rpm: float) -> int:
    """Code of a speed reference in rpm."""
    return (round(rpm) * INVERSE_BASE) >> 5


def held_rpm(rpm: float) -> float:
    """Speed in rpm that the code of a reference in rpm stands for."""
    return reference_code(rpm) * BASE_RPM / 32768.0


def dead_band(constants: Constants) -> float:
    """Error of i_q in A from which on the integral of its controller acts.

    The shift rounds down: between 0 and this nothing is added, just below 0 one is taken off in
    every period.
    """
    return BASE_CURRENT / constants.kih_iq


def program_files(torque_per_ampere: float, period: float, align: int = 0) -> dict[str, bytes]:
    """The two headers by name.

    Args:
        torque_per_ampere: Of the machine in N m/A, for the recorded torque reference.
        period: Of the interrupt in s.
        align: Periods for which the first phase is fed before the program begins, and after which
            the encoder's count is set to zero; 0 for a program that knows the angle.
    """
    turn = 2.0 * np.pi * np.arange(_SINE_ENTRIES + 1) / _SINE_ENTRIES
    context = {
        "prefix": PREFIX,
        "sine": np.rint(32767.0 * np.sin(turn)).astype(int).tolist(),
        "sine_shift": 15 - _SINE_ENTRIES.bit_length() + 1,
        "timer_period": TIMER_PERIOD,
        "inverse_base": INVERSE_BASE,
        "encoder_lines": float(ENCODER.lines),
        "clock": CLOCK,
        "period": period,
        "constants": list(asdict(Constants()).values()),
        "align": align,
        "torque_per_ampere": torque_per_ampere,
    }
    return {
        "thesis_program.h": render("papers/paper001/thesis_program.h.j2", context).encode("ascii"),
        f"{PREFIX}_control.h": render("papers/paper001/thesis_control.h.j2", context).encode(
            "ascii"
        ),
    }


@dataclass(frozen=True, slots=True)
class ProgramBench:
    """The bench with the program of the thesis compiled in."""

    program: Simulator
    drive: Drive

    def run(
        self,
        duration: float,
        reference: Profile,
        constants: Constants | None = None,
        dead_time: float | None = None,
        inverter: InverterModel = "averaged",
        theta_e: float = 0.0,
        friction: float = 0.0,
    ) -> Simulation:
        """One run from standstill: seconds, reference in rad/s, other integers or dead time in s
        where they are given, duty cycles as voltages or every switching instant; the electrical
        angle in rad at which the rotor lies, and a torque in N m that resists and holds it.
        """
        scenario = Scenario(
            duration,
            "speed",
            reference,
            encoder=ENCODER,
            sensor=CONVERTER,
            dead_time=dead_time,
            inverter=inverter,
            theta_e=theta_e,
            load=constant(friction),
            load_kind="friction" if friction else "active",
        )
        gains = (constants or Constants()).content()
        return simulate(self.program, self.drive, scenario, gains=gains)


@contextmanager
def program_bench(design: Design, align: int = 0) -> Iterator[ProgramBench]:
    """The bench of a design with the program of the thesis, as long as the block; with its
    alignment over so many periods, where it is to find the angle itself.

    Raises:
        VerificationError: There is no compiler.
    """
    files = program_files(design.machine.torque_per_ampere, design.control.t_s, align)
    with simulator(files, PREFIX) as program:
        yield ProgramBench(program, drive_of(design))
