"""Flux linkage of the magnets from the keys that imply it, once all agree."""

from __future__ import annotations

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import FluxStatement, InputValue, Reading
from dqforge.machines.design.sections.machine.schema import MachineSection
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.units.quantities import format_quantity

# Keys that imply the flux linkage of the magnets, in order of trust.
FLUX_KEYS = ("magnet_flux", "back_emf_constant", "torque_constant", "kv")


def read_magnet_flux(section: MachineSection, pole_pairs: int, reading: Reading) -> float:
    """Flux linkage of the magnets from the first of the keys that imply it, once all agree."""
    statements = _flux_statements(section, pole_pairs, reading)
    if not statements:
        raise reading.document.error(
            "machine needs magnet_flux, back_emf_constant, torque_constant or kv; write e.g. "
            "magnet_flux: 0.06 Wb (0 Wb for a reluctance machine)",
            ("machine",),
            key=True,
        )
    # Whichever of the keys stands last in the file is the one that
    # contradicts what was read before.
    last = max(statements, key=lambda s: reading.document.position(("machine", s.key)))
    with reading.document.at(("machine", last.key)):
        datasheet.check_flux_agreement(statements, pole_pairs)
    used = statements[0]
    if used.key != "magnet_flux":
        note = f"derived from {used.key} {used.text} with {pole_pairs} pole pairs"
        reading.derived.append(
            InputValue("machine.magnet_flux", "", used.psi_pm, "Wb", inferred=True, note=note)
        )
        reading.remarks.append(
            f"machine.magnet_flux is {format_quantity(used.psi_pm, 'Wb')} (peak of phase), {note}"
        )
    return used.psi_pm


def _flux_statements(
    section: MachineSection, pole_pairs: int, reading: Reading
) -> list[FluxStatement]:
    """What each given key says about the flux linkage, in order of trust."""
    statements = []
    if (flux := section.magnet_flux) is not None:
        psi_pm = reading.phase_flux(flux, "machine.magnet_flux")
        statements.append(FluxStatement("magnet_flux", _said(flux), psi_pm, counts_poles=False))
    if (emf := section.back_emf_constant) is not None:
        psi_pm = datasheet.flux_from_back_emf(
            emf.si, emf.kind or "", pole_pairs, section.connection
        )
        statements.append(FluxStatement("back_emf_constant", _said(emf), psi_pm, counts_poles=True))
        inverted = "reciprocal of the speed per volt; " if emf.inverted else ""
        implied = f"{inverted}implies a magnet flux of {format_quantity(psi_pm, 'Wb')}"
        reading.converted["machine.back_emf_constant"] = (emf.si, implied)
    if (constant := section.torque_constant) is not None:
        reading.check_current_kind(constant, ("machine", "torque_constant"))
        kind = constant.kind or ""
        psi_pm = datasheet.flux_from_torque_constant(
            constant.si, kind, pole_pairs, section.connection
        )
        statements.append(
            FluxStatement("torque_constant", _said(constant), psi_pm, counts_poles=True)
        )
        implied = f"implies a magnet flux of {format_quantity(psi_pm, 'Wb')}"
        reading.converted["machine.torque_constant"] = (constant.si, implied)
    if (speed := section.kv) is not None:
        psi_pm = datasheet.flux_from_kv(speed.si, speed.kind or "", pole_pairs, section.connection)
        statements.append(FluxStatement("kv", _said(speed), psi_pm, counts_poles=True))
        implied = f"implies a magnet flux of {format_quantity(psi_pm, 'Wb')}"
        reading.converted["machine.kv"] = (speed.si, implied)
    return statements


def _said(quantity: Quantity) -> str:
    return f"{quantity.text} ({quantity.kind})"
