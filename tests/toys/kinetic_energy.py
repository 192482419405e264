"""A capability from outside the package: the kinetic energy that a drive brakes away."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import Harness, HeaderKind, Programme, single_from, title
from dqforge.reports.capability import Capability, Draw, Outcome, Quantity, ReportPart, Tile
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import quantity
from dqforge.reports.pages.templating import Chapter, render
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent


# The decision: floor optimizer, room kinetic_energy.
@dataclass(frozen=True, slots=True)
class KineticEnergy:
    """Energy of the rotor.

    ``inertia`` in kg m^2; ``omega_m`` in rad/s and ``energy`` in J, shape (N,).
    """

    inertia: float
    omega_m: FloatArray
    energy: FloatArray

    @property
    def largest(self) -> float:
        """Energy at the largest speed in J."""
        return float(self.energy[-1])


def solve_kinetic_energy(outcome: Outcome) -> KineticEnergy | None:
    """The energy up to the largest speed, None where speed or inertia are not known."""
    machine = outcome.design.machine
    if machine.inertia is None or machine.omega_m_max is None:
        return None
    omega_m = np.linspace(0.0, machine.omega_m_max, 50)
    return KineticEnergy(machine.inertia, omega_m, 0.5 * machine.inertia * omega_m**2)


# What is said of it: floor reports, room kinetic_energy.
def plain_energy(_: Solution, found: KineticEnergy) -> PlainData:
    return {
        "omega_m_rad_per_s": found.omega_m,
        "energy_J": found.energy,
        "largest_J": found.largest,
    }


def energy_table(solution: Solution, found: KineticEnergy) -> list[Table]:
    rows = tuple(
        (f"{omega_m:.4g}", f"{energy:.4g}")
        for omega_m, energy in zip(found.omega_m[::7], found.energy[::7], strict=True)
    )
    return [Table(f"{solution.design.name}: kinetic energy", ("rad/s", "J"), rows)]


def plot_energy(found: KineticEnergy) -> Figure:
    from dqforge.reports.pages.figures_style import new_figure, style

    with style():
        figure = new_figure("energy", 3.0, "Kinetic energy over the mechanical speed")
        axes = figure.subplots()
        axes.plot(found.omega_m, found.energy)
        axes.set_xlabel("mechanical speed in rad/s")
        axes.set_ylabel("energy in J")
    return figure


CHAPTER = Chapter("kinetic_energy", "Kinetic energy")


def energy_parts(_: Solution, found: KineticEnergy) -> list[ReportPart]:
    data = {"energy": quantity(found.largest, "J")}
    return [ReportPart(CHAPTER, str(HERE / "kinetic_energy.html.j2"), data)]


def energy_figures(_: Solution, found: KineticEnergy) -> Mapping[str, Draw]:
    return {"energy": lambda: plot_energy(found)}


# Its header: the C, what the result says of it, and the model that the C must equal.
@dataclass(frozen=True, slots=True)
class EnergyModel:
    """The header in numpy: half the inertia in kg m^2."""

    half_inertia: np.float32


def energy_files(solution: Solution, found: KineticEnergy) -> dict[str, bytes]:
    names = title(solution.design) | {"half_inertia": shortest(np.float32(0.5 * found.inertia))}
    text = render(str(HERE / "kinetic_energy.h.j2"), names)
    return {f"{names['prefix']}_kinetic_energy.h": text.encode("ascii")}


def plain_model(_: Solution, found: KineticEnergy) -> PlainData:
    return {"half_inertia": shortest(np.float32(0.5 * found.inertia))}


def read_model(own: Mapping[str, Any], _: Mapping[str, Any]) -> EnergyModel:
    try:
        return EnergyModel(single_from(own["half_inertia"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError("kinetic_energy_header is not what dqforge writes") from error


def energy_programme(model: EnergyModel) -> Programme:
    speeds = np.linspace(-2000.0, 2000.0, 4001, dtype=np.float32)
    energies = ((model.half_inertia * speeds) * speeds)[:, np.newaxis]
    harness = Harness(
        "kinetic_energy",
        "speed in rad/s; energy in J",
        (1, 1),
        ("out[0] = @_kinetic_energy_J(in[0]);",),
        vectors=False,
    )
    return Programme(harness, speeds, energies, "kinetic energy")


KINETIC_ENERGY = Capability(
    name="kinetic_energy",
    title="kinetic energy of the rotor",
    of=solve_kinetic_energy,
    plain=plain_energy,
    summary=lambda _, found: [("kinetic energy", f"{found.largest:.4g} J at the largest speed")],
    tables=energy_table,
    tiles=lambda _, found: [Tile("Kinetic energy", quantity(found.largest, "J"), "to be braked")],
    figures=energy_figures,
    parts=energy_parts,
    headers=(
        HeaderKind(
            name="kinetic_energy",
            files=energy_files,
            plain=plain_model,
            read=read_model,
            programme=energy_programme,
            vectors=False,
        ),
    ),
    quantities=(Quantity("kinetic energy", "largest", "J", ("kinetic_energy", "largest_J")),),
)
