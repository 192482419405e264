"""Inductances of both axes, or the one that a data sheet has for both."""

from __future__ import annotations

from dqforge.machines.design.design import AGREEMENT, Reading
from dqforge.machines.design.sections.machine.schema import MachineSection
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import format_quantity


def read_inductances(section: MachineSection, reading: Reading) -> tuple[float, float]:
    """Inductances of the d and the q axis in H, of a phase.

    The inductance that a data sheet has for both lies between the two, whatever the position of the
    rotor: between two terminals twice as much.

    Raises:
        InputError: One axis alone is given, or what is given for both contradicts the two.
    """
    axes = {
        key: reading.per_phase(entry, f"machine.{key}")
        for key, entry in (
            ("inductance_d", section.inductance_d),
            ("inductance_q", section.inductance_q),
        )
        if entry is not None
    }
    if section.inductance is None:
        return axes["inductance_d"], axes["inductance_q"]
    one = reading.per_phase(section.inductance, "machine.inductance")
    if not axes:
        reading.remarks.append(
            f"machine.inductance {format_quantity(one, 'H')} is taken for both axes; between two "
            "terminals of a rotor with saliency one measures 2 L_d to 2 L_q as it is turned: write "
            "inductance_d and inductance_q where they differ"
        )
        return one, one
    _check(one, axes, reading)
    return axes["inductance_d"], axes["inductance_q"]


def _check(one: float, axes: dict[str, float], reading: Reading) -> None:
    """Refuse what is given for both axes beside one of them, or where it is not between the two."""
    if len(axes) == 1:
        raise _refusal(
            f"machine.inductance is that of both axes, and {next(iter(axes))} that of one; remove "
            "one of the two keys",
            reading,
        )
    low, high = sorted(axes.values())
    if (1.0 - AGREEMENT) * low <= one <= (1.0 + AGREEMENT) * high:
        return
    told = " and ".join(f"{key} {format_quantity(value, 'H')}" for key, value in axes.items())
    raise _refusal(
        f"machine.inductance {format_quantity(one, 'H')} (phase) contradicts {told}, between which "
        "it must lie; check the kinds (phase or line-to-line), or remove it",
        reading,
    )


def _refusal(message: str, reading: Reading) -> InputError:
    return reading.document.error(message, ("machine", "inductance"), key=True)
