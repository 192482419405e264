"""The flux map of a design: its files, what the design declares of them,
and what the map itself says to that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design import datasheet
from dqforge.machines.design.reading import Reading
from dqforge.machines.design.sections.machine.delta import at_the_terminals
from dqforge.machines.design.sections.machine.flux_map_schema import FluxMapSection
from dqforge.machines.design.sections.machine.schema import MachineSection
from dqforge.machines.design.values import InputValue
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass

if TYPE_CHECKING:  # the readers are needed for maps only
    from dqforge.machines.flux_maps.building import FluxMapReading
    from dqforge.machines.flux_maps.torque_check import TorqueCheck


_PATH: KeyPath = ("machine", "flux_map")


_SYMMETRIC = 1e-6

"""Asymmetry over the largest flux linkage below which the halves of a map are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class FluxMaps:
    """The map that everything is computed with, and that of both halves as they are,
    None where none is known.
    """

    symmetric: FluxMap
    whole: FluxMap | None = None


def read_flux_maps(
    section: MachineSection, pole_pairs: int, reading: Reading, expected: float | None, i_max: float
) -> FluxMaps:
    """Flux maps of the files that the section names, at the temperature of the magnets.

    Parameters
    ----------
    section:
        With the key flux_map.
    pole_pairs:
        Of the machine; the torque in a file is held against them.
    reading:
        Takes the findings, and slope and misfit of the torque.
    expected:
        Known flux linkage of the magnets in Wb, or None.
    i_max:
        Current limit in A (peak), at which the asymmetry is told where no rated current is given.

    Raises
    ------
    InputError
        A file cannot be read, or is no map of a machine as it is declared.
    """
    from dqforge.machines.flux_maps.magnet_temperatures import flux_map_of_maps

    given = section.flux_map
    if given is None or (given.file is None) == (given.files is None):
        raise reading.document.error(
            "machine.flux_map: write either file or files", _PATH, key=True
        )
    rated = section.rated.current
    at = (i_max, "current limit")
    if rated is not None:
        at = (
            datasheet.peak_current(rated.si, rated.kind or "", section.connection),
            "rated current",
        )
    if given.file is not None:
        found = _one_map(given, given.file, (*_PATH, "file"), pole_pairs, reading, expected)
        return _told(given, given.file, found, reading, pole_pairs, at)
    files = given.files or ()
    for key in ("psi_q_file", "torque_file"):
        if getattr(given, key) is not None:
            message = (
                f"machine.flux_map.{key} goes with file, not with files; write maps of one file "
                "each"
            )
            raise reading.document.error(message, (*_PATH, key), key=True)
    magnet = section.temperature.magnet
    if magnet is None:
        raise reading.document.error(
            "machine.flux_map.files needs machine.temperature.magnet, the temperature at which the "
            "machine runs; write temperature: {magnet: 80 degC}",
            (*_PATH, "files"),
            key=True,
        )
    maps = []
    for index, part in enumerate(files):
        found = _one_map(given, part.file, (*_PATH, "files", index, "file"), pole_pairs, reading)
        maps.append(_told(given, part.file, found, reading, pole_pairs, at))
    temperatures = np.array([part.magnet_temperature.si for part in files])
    wholes = [part.whole for part in maps if part.whole is not None]
    with reading.document.at(("machine", "temperature", "magnet")):
        whole = (
            flux_map_of_maps(temperatures, wholes, magnet.si) if len(wholes) == len(maps) else None
        )
        return FluxMaps(
            flux_map_of_maps(temperatures, [part.symmetric for part in maps], magnet.si), whole
        )


def _told(
    given: FluxMapSection,
    name: str,
    found: FluxMapReading,
    reading: Reading,
    pole_pairs: int,
    at: tuple[float, str],
) -> FluxMaps:
    """Maps of one file, with its fit and its asymmetry at a current in A told among the remarks."""
    from dqforge.machines.flux_maps.asymmetry import asymmetry_of
    from dqforge.machines.flux_maps.evidence import FluxEvidence

    asymmetry = None
    if found.whole is not None and found.asymmetry > _SYMMETRIC * float(
        np.max(np.abs(found.whole.psi_d))
    ):
        asymmetry = asymmetry_of(found.whole, found.flux_map, pole_pairs, *at, given.symmetry)
    evidence = FluxEvidence(name, found.fit, asymmetry, pole_pairs)
    reading.flux_evidence.append(evidence)
    reading.remarks.extend(f"{name}: {sentence}" for sentence in evidence.sentences())
    return FluxMaps(found.flux_map, found.whole)


def _one_map(
    given: FluxMapSection,
    name: str,
    path: KeyPath,
    pole_pairs: int,
    reading: Reading,
    expected: float | None = None,
) -> FluxMapReading:
    """Flux map of one file, its findings among the remarks.

    ``expected`` is the known magnet flux in Wb.
    """
    # A design with constants starts faster without the readers.
    from dqforge.machines.flux_map_files.files import read_flux_points
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map

    columns = {key: value for key, value in given.columns if value is not None}
    content = reading.read_beside(name, path)
    beside = {"psi_q": given.psi_q_file, "torque": given.torque_file}
    companions = {
        quantity: (reading.read_beside(file, (*_PATH, f"{quantity}_file")), file)
        for quantity, file in beside.items()
        if file is not None
    }
    at = {
        key: si
        for key in ("temperature", "speed")
        if (si := si_of(getattr(given.at, key))) is not None
    }
    try:
        points = read_flux_points(
            content,
            name,
            current_unit=given.current_unit,
            flux_unit=given.flux_unit,
            columns=columns or None,
            at=at,
            companions=companions,
        )
        found = build_flux_map(
            at_the_terminals(points, given),
            axes=given.axes,
            scaling=given.scaling if "scaling" in given.model_fields_set else None,
            extrapolate=given.extrapolate,
            expected_psi_pm=expected,
            pole_pairs=pole_pairs,
            torque=given.torque,
            treatment=FluxTreatment(given.fit, given.symmetry, si_of(given.frame_angle) or 0.0),
        )
    except InputError as error:
        if error.line is not None:
            raise
        file = error.source or name
        about = error.message if file in error.message else f"{file}: {error.message}"
        raise reading.document.error(f"machine.flux_map: {about}", path) from None
    reading.remarks.extend(f"{name}: {finding}" for finding in found.findings)
    if found.torque is not None:
        reading.derived.extend(_torque_values(".".join(map(str, path[:-1])), found.torque))
    return found


def _torque_values(path: str, found: TorqueCheck) -> list[InputValue]:
    """Slope, offset and misfit of the torque in a file as values of the design."""
    over = (
        f"torque of the file ({found.name}) over 3/2 p (psi_d i_q - psi_q i_d), {found.points} "
        "points"
    )
    rows = [("torque_slope", found.slope, "", f"{over}: slope of the least-squares line")]
    if found.declared == "shaft":
        rows.append(("torque_offset", found.offset, "N m", f"{over}: that line at zero"))
    rows.append(
        (
            "torque_misfit",
            found.misfit,
            "",
            f"{over}: r.m.s. distance from that line over the r.m.s. torque",
        )
    )
    return [
        InputValue(f"{path}.{name}", "", value, unit, note=note) for name, value, unit, note in rows
    ]
