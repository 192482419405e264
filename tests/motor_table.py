"""The table of motors on docs/reference/motors.md, from the files themselves.

As a program, ``python tests/motor_table.py`` writes it into the page.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "motors.md"
HEAD = (
    "| name | motor | p | R, mOhm | L_d, L_q, mH | psi_pm, mWb | Kv, rpm/V | link, V | source |",
    "|---|---|---|---|---|---|---|---|---|",
)


def head(name: str) -> str:
    """Comment above a motor, one line: its sources and what its values may be off by."""
    lines = catalogue.read_text(name).decode().split("# tags:")[0].splitlines()
    return " ".join(line.removeprefix("#").strip() for line in lines).strip()


def linear(design: Design) -> LinearMachine:
    """The machine of a motor, which has constant inductances."""
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    return machine


def speed_constant(machine: LinearMachine) -> float:
    """Kv in rpm per volt of the peak between two terminals."""
    volts = math.sqrt(3.0) * machine.pole_pairs * machine.psi_pm
    return 60.0 / (2.0 * math.pi * volts)


def digits(value: float) -> str:
    """Three digits, of what is above a thousand all before the point."""
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def row(name: str) -> str:
    """Line of the table of one motor: values of a phase, with three digits."""
    design = catalogue.load(name)
    machine = linear(design)
    l_d, l_q = (f"{1e3 * value:.3g}" for value in (machine.l_d, machine.l_q))
    (source,) = (value.source for value in design.values if value.path == "machine.resistance")
    cells = (
        f"`{name}`",
        design.name,
        f"{machine.pole_pairs}",
        digits(1e3 * machine.r_s),
        l_d if l_d == l_q else f"{l_d}, {l_q}",
        digits(1e3 * machine.psi_pm),
        digits(speed_constant(machine)),
        f"{design.inverter.v_dc:.0f}",
        _shown(re.split(r", (?:RS?$|R[ms]|R_|R20|phase|FOC_|ORNL)", source)[0]),
    )
    return f"| {' | '.join(cells)} |"


def _shown(source: str) -> str:
    """Names of files and repositories as code."""
    return f"`{source}`" if re.search(r"[/_]|\.[hps]", source) else source


def table() -> list[str]:
    """All lines of the table."""
    return [*HEAD, *(row(name) for name in catalogue.motors())]


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(HEAD[0])
    after = rest.partition("\n\n")[2]
    PAGE.write_text(before + "\n".join(table()) + "\n\n" + after, encoding="utf-8")
