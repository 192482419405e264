"""What the report says of the conventions and of the model of a machine: true for this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.optimizer.solution import Solution
from dqforge.reports.pages.html_text import symbols

if TYPE_CHECKING:
    from markupsafe import Markup

_VELOCITY_FORM = "d[k] = d[k\u22121] + kp (e[k] \u2212 e[k\u22121]) + ki T e[k]"


def convention_lines(solution: Solution) -> list[Markup]:
    """Conventions of the numbers of a report, and what its model of the machine leaves out.

    Args:
        solution: Of a design.
    """
    from markupsafe import Markup

    lines = [
        symbols(
            "dq quantities are amplitude-invariant: currents, voltages and fluxes are peak values "
            "of a phase."
        ),
        symbols(
            f"{_axis_words(solution.design)} Electrical speed is pole pairs times mechanical speed."
        ),
        Markup(
            "Torque is 3/2 <i>p</i> (\u03c8<sub>d</sub> <i>i</i><sub>q</sub> \u2212 "
            "\u03c8<sub>q</sub> <i>i</i><sub>d</sub>); copper loss is 3/2 <i>R</i><sub>s</sub> "
            "(<i>i</i><sub>d</sub>\u00b2 + <i>i</i><sub>q</sub>\u00b2)."
        ),
    ]
    if solution.loops is not None:
        form = Markup('<span class="mono">{}</span>').format(_VELOCITY_FORM)
        lines.append(Markup("PI controllers: {}.").format(form))
    return [*lines, *(symbols(line) for line in machine_lines(solution.design))]


def _axis_words(design: Design) -> str:
    if abs(design.machine.psi_pm) < 1e-9:
        greater = "greater" if design.machine.l_d > design.machine.l_q else "smaller"
        return f"The machine has no magnets; the d axis is that of the {greater} inductance."
    return "The d axis lies along the magnet flux; negative i_d weakens the field."


def machine_lines(design: Design) -> list[str]:
    """What the model of a machine holds, and what it leaves out.

    Args:
        design: Says what is known of the machine.
    """
    lines = [_inductance_words(design)]
    if design.phase_machine is not None:
        lines.append(
            "The back-EMF has the harmonics of the design; current reference and losses in dq are "
            "those of its fundamental."
        )
    lines.append(_iron_words(design))
    return lines


def _inductance_words(design: Design) -> str:
    if not isinstance(design.machine, LinearMachine):
        return (
            "Flux linkages follow a map over both currents: saturation is part of the model, and "
            "inductances are stated at zero current where no current is named."
        )
    if isinstance(design.phase_machine, SalientPhaseMachine):
        return (
            "Inductances vary with the angle of the rotor, not with the current: saturation is no "
            "part of the model."
        )
    return "Inductances are constant: saturation is no part of the model."


def _iron_words(design: Design) -> str:
    loss = design.machine_loss
    if loss.hysteresis == 0.0 and loss.eddy == 0.0:
        return "The design gives no iron loss, and none is counted."
    return "Iron loss is counted where losses are, from the flux linkage and the electrical speed."
