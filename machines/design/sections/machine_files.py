"""What a design has in files beside it: its flux map and its back-EMF, what the design declares of
them, and what they say themselves to that; and windings in delta.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import InputValue, Reading
from dqforge.machines.design.sections.machine_schema import (
    BackEmfSection,
    FluxMapSection,
    HarmonicSection,
    MachineSection,
)
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import torque_from_flux
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError, KeyPath
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.machines.flux_maps.building import FluxMapReading
    from dqforge.machines.flux_maps.checks import MeasuredLoss
    from dqforge.machines.flux_maps.flux_points import FluxPoints, TorqueCheck


_PATH: KeyPath = ("machine", "flux_map")

RIPPLE_LEFT = "the ripple over the rotor angle is averaged away: it is not kept"

# Asymmetry over the largest flux linkage below which the halves of a map are the same.
_SYMMETRIC = 1e-6

# Torque over that of the points of the file from which on it is none of theirs, and the currents at
# which it is looked for.
_FAR_TORQUE, _ANGLES, _SHARES = 1.5, 91, 13


@dataclass(frozen=True, slots=True, eq=False)
class FluxMaps:
    """The map that everything is computed with, and that of both halves as they are,
    None where none is known.

    ``losses`` are those that the files give, with their names.
    """

    symmetric: FluxMap
    whole: FluxMap | None = None
    losses: tuple[tuple[str, MeasuredLoss], ...] = ()


def read_flux_maps(
    section: MachineSection,
    pole_pairs: int,
    reading: Reading,
    expected: float | None,
    i_max: float,
) -> FluxMaps:
    """Flux maps of the files that the section names, at the temperature of the magnets.

    Args:
        section: With the key flux_map.
        pole_pairs: Of the machine; the torque in a file is held against them.
        reading: Takes the findings, and slope and misfit of the torque.
        expected: Known flux linkage of the magnets in Wb, or None.
        i_max: Current limit in A (peak), at which the asymmetry is told where no rated current is
            given.

    Raises:
        InputError: A file cannot be read, or is no map of a machine as it is declared.
    """
    from dqforge.machines.flux_maps.fit import flux_map_of_maps

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
        found = _one_map(given, given.file, (*_PATH, "file"), pole_pairs, reading, i_max, expected)
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
        found = _one_map(
            given, part.file, (*_PATH, "files", index, "file"), pole_pairs, reading, i_max
        )
        maps.append(_told(given, part.file, found, reading, pole_pairs, at))
    temperatures = np.array([part.magnet_temperature.si for part in files])
    if any(part.symmetric.ripple is not None for part in maps):
        reading.remarks.append(f"{RIPPLE_LEFT} with several files")
    wholes = [part.whole for part in maps if part.whole is not None]
    with reading.document.at(("machine", "temperature", "magnet")):
        whole = (
            flux_map_of_maps(temperatures, wholes, magnet.si) if len(wholes) == len(maps) else None
        )
        return FluxMaps(
            flux_map_of_maps(temperatures, [part.symmetric for part in maps], magnet.si),
            whole,
            tuple(loss for part in maps for loss in part.losses),
        )


def losses_told(maps: FluxMaps, r_s: float, reading: Reading) -> None:
    """What remains of the losses in the files without the copper loss of a resistance in Ohm, among
    the remarks.
    """
    if not maps.losses:
        return
    from dqforge.machines.flux_maps.checks import loss_findings

    reading.remarks.extend(
        f"{name}: {finding}" for name, loss in maps.losses for finding in loss_findings(loss, r_s)
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
    from dqforge.machines.flux_maps.building import asymmetry_of
    from dqforge.machines.flux_maps.evidence import FluxEvidence

    asymmetry = None
    if found.whole is not None and found.asymmetry > _SYMMETRIC * float(
        np.max(np.abs(found.whole.psi_d))
    ):
        asymmetry = asymmetry_of(found.whole, found.flux_map, pole_pairs, *at, given.symmetry)
    evidence = FluxEvidence(name, found.fit, asymmetry, pole_pairs)
    reading.flux_evidence.append(evidence)
    reading.remarks.extend(f"{name}: {sentence}" for sentence in evidence.sentences())
    losses = () if found.loss is None else ((name, found.loss),)
    return FluxMaps(found.flux_map, found.whole, losses)


def _one_map(
    given: FluxMapSection,
    name: str,
    path: KeyPath,
    pole_pairs: int,
    reading: Reading,
    i_max: float,
    expected: float | None = None,
) -> FluxMapReading:
    """Flux map of one file, its findings among the remarks.

    ``expected`` is the known magnet flux in Wb, ``i_max`` the current limit in A (peak).
    """
    # A design with constants starts faster without the readers.
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map
    from dqforge.machines.flux_maps.coordinates import Declared
    from dqforge.machines.flux_maps.map_files import read_flux_points

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
    scaling = given.scaling if "scaling" in given.model_fields_set else None
    of_phase = None
    if given.resistance is not None:
        kind = given.resistance.kind or "phase"
        of_phase = datasheet.phase_resistance(given.resistance.si, kind, "star")
    try:
        points = read_flux_points(
            content,
            name,
            current_unit=given.current_unit,
            flux_unit=given.flux_unit,
            columns=columns or None,
            at=at,
            companions=companions,
            torque=given.torque,
            declared=Declared(pole_pairs, of_phase, scaling),
        )
        whole = at_the_terminals(points, given)
        found = build_flux_map(
            whole,
            axes=given.axes,
            scaling=scaling,
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
    if "torque" in given.model_fields_set and found.torque is None and not points.ignored:
        raise reading.document.error(
            f"machine.flux_map.torque: {name} holds no torque that it could be about; remove the "
            "key, or name the column, columns: {torque: NAME}",
            (*_PATH, "torque"),
        )
    _refuse_far_torque(found, name, path, pole_pairs, reading, i_max)
    reading.remarks.extend(f"{name}: {finding}" for finding in found.findings)
    if points.turning is not None and whole.turning is None:
        reading.remarks.append(f"{name}: {RIPPLE_LEFT} in a delta")
    if points.deviations is not None:
        plain = given.axes == "magnet-d" and (scaling or points.claimed or "peak") == "peak"
        if plain and si_of(given.frame_angle) in (None, 0.0) and whole is points:
            known = replace(found.flux_map, deviations=points.deviations)
            found = replace(found, flux_map=known)
        else:
            reading.remarks.append(
                f"{name}: its standard deviations are not used: they go with axes: magnet-d, "
                "scaling: peak, currents of lines and no frame_angle"
            )
    if found.torque is not None:
        reading.derived.extend(_torque_values(".".join(map(str, path[:-1])), found.torque))
    return found


def _refuse_far_torque(
    found: FluxMapReading,
    name: str,
    path: KeyPath,
    pole_pairs: int,
    reading: Reading,
    i_max: float,
) -> None:
    """Refuse a map that makes far more torque within the current limit than its own points do.

    Torque grows with the square of the current at most; beyond the points it may be extrapolated
    to anything.
    """
    angle, share = np.linspace(0.0, np.pi, _ANGLES), np.linspace(0.0, 1.0, _SHARES)[1:]
    i_d, i_q = (i_max * np.outer(share, part).ravel() for part in (np.cos(angle), np.sin(angle)))
    if not found.flux_map.extrapolate:
        within = found.flux_map.inside(i_d, i_q)
        i_d, i_q = i_d[within], i_q[within]
    psi_d, psi_q = found.flux_map.flux(i_d, i_q)
    made = float(np.max(np.abs(torque_from_flux(1, psi_d, psi_q, i_d, i_q)), initial=0.0))
    most, current = found.most
    if not most > 0.0 or made <= _FAR_TORQUE * most * max(1.0, i_max / current) ** 2:
        return
    extrapolated = found.flux_map.extrapolate
    advice = "leave extrapolate out" if extrapolated else "write fit: smooth, or add points"
    raise reading.document.error(
        f"machine.flux_map: {name} would make "
        f"{format_quantity(pole_pairs * made, 'N m', 4)} within max_current, its own points reach "
        f"{format_quantity(pole_pairs * most, 'N m', 4)} at up to "
        f"{format_quantity(current, 'A', 4)}: that torque is "
        f"{'extrapolated' if extrapolated else 'between its points'}, not known; {advice}",
        path,
    )


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


# Windings in delta: what can be converted to the equivalent star, and what cannot.
#
# Seen from its terminals a delta without zero sequence is a star
# (`dqforge.machines.design.design`). A zero sequence of the back-EMF short-circuits itself in the
# delta, and its current is in no terminal: the star knows nothing of it.

_SQRT3 = math.sqrt(3.0)


def check_connection(section: MachineSection, reading: Reading) -> None:
    """Refuse what a delta cannot have or leaves open, and tell what was converted.

    Raises:
        InputError: The model is one in phase quantities or by coefficients, or a flux map does not
            say what it holds.
    """
    given = section.flux_map
    if section.connection == "star":
        if given is not None and given.quantities is not None:
            message = (
                "machine.flux_map.quantities is for windings in delta; write connection: delta, or "
                "remove it"
            )
            raise reading.document.error(message, ("machine", "flux_map", "quantities"), key=True)
        return
    if section.model in _REFUSED:
        raise reading.document.error(
            f"machine.connection: delta does not go with model: {section.model}; "
            f"{_REFUSED[section.model]}",
            ("machine", "connection"),
        )
    if given is not None and given.quantities is None:
        raise reading.document.error(
            "machine.flux_map: in a delta the flux linkages and currents of windings are not those "
            "of lines; write quantities: winding (of finite elements, mostly) or quantities: line "
            "(as measured at the terminals)",
            ("machine", "flux_map"),
            key=True,
        )
    reading.remarks.append(
        "machine.connection is delta: its data are converted to the equivalent star at the "
        "terminals; the angle counts from phase a of that star, 30 deg (electrical) behind the "
        "winding between terminals a and b"
    )
    reading.remarks.append(
        "the back-EMF of the delta is taken as sinusoidal: harmonics of orders 3, 9, 15, ... drive "
        "a current around it that no terminal carries, and whose loss and torque are not counted"
    )


_REFUSED = {
    "waveform": (
        "harmonics of orders 3, 9, 15, ... of its back-EMF drive a current around the delta that "
        "no terminal carries and that this program does not compute; write the line-to-line "
        "back-EMF over sqrt(3) as a star"
    ),
    "saturation": "published coefficients belong to the star; write connection: star",
}


def at_the_terminals(points: FluxPoints, section: FluxMapSection) -> FluxPoints:
    """Points of a flux map in quantities of lines: of windings in delta sqrt(3) i and psi /
    sqrt(3).
    """
    if section.quantities != "winding":
        return points
    return replace(
        points,
        i_d=points.i_d * _SQRT3,
        i_q=points.i_q * _SQRT3,
        psi_d=points.psi_d / _SQRT3,
        psi_q=points.psi_q / _SQRT3,
        turning=None,
    )


# The back-EMF of a design file, as harmonics or from a capture beside the design, and its
# saliency.

_BACK_EMF_PATH: KeyPath = ("machine", "back_emf")


_SALIENCY: KeyPath = ("machine", "inductance_harmonics")


_MOST_ORDER = 200


_MOST_LAG = np.deg2rad(0.5)


def read_phase_machine(
    section: MachineSection, common: Mapping[str, Any], reading: Reading
) -> PhaseMachine:
    """Machine in phase quantities; ``common`` holds what all models share.

    Raises:
        InputError: The back-EMF is given twice or not at all, contradicts itself, or its capture is
            not sound.
    """
    given = section.back_emf
    sources = () if given is None else (given.harmonics, given.file, given.files)
    if (
        given is None
        or section.self_inductance is None
        or sum(source is not None for source in sources) != 1
    ):
        raise reading.document.error(
            "machine.back_emf: write either harmonics, file or files", _BACK_EMF_PATH, key=True
        )
    if section.temperature.magnet is not None:
        raise reading.document.error(
            "machine.temperature.magnet: a back-EMF holds for the magnets as they were; write it "
            "for the temperature",
            ("machine", "temperature", "magnet"),
            key=True,
        )
    l_s = reading.per_phase(section.self_inductance, "machine.self_inductance")
    m_s = si_of(section.mutual_inductance) or 0.0
    if section.self_inductance.kind == "line-to-line":
        l_s += m_s  # between two terminals lie 2 (L_s - M_s)
        done = "half of the line-to-line value, and the mutual inductance"
        reading.converted["machine.self_inductance"] = (l_s, done)
    if section.mutual_inductance is None:
        reading.remarks.append(
            "machine.mutual_inductance is 0: the phases do not act on each other, and a "
            "self_inductance between two terminals holds what does"
        )
    orders, amplitudes, phases = (
        _written(given, common["pole_pairs"], reading)
        if given.harmonics is not None
        else _captured(given, common["pole_pairs"], reading)
    )
    with reading.document.at(_BACK_EMF_PATH, key=True):
        machine = PhaseMachine.from_harmonics(
            orders,
            amplitudes,
            phases,
            pole_pairs=common["pole_pairs"],
            r_s=common["r_s"],
            l_s=l_s,
            m_s=m_s,
            i_max=common["i_max"],
        )
        if given.harmonics is None and _is_averaged(given):
            machine = machine.symmetrised()
            both = " and of both half waves" if machine.turns == 1 else ""
            reading.remarks.append(f"machine.back_emf is the mean of the three phases{both}")
    if section.inductance_harmonics is None:
        reading.remarks.append(
            f"the dq values of the machine are those of the fundamental: psi_pm "
            f"{format_quantity(machine.psi_pm, 'Wb')}, l_d = l_q = "
            f"{format_quantity(l_s - m_s, 'H')}"
        )
    return machine


def _is_averaged(given: BackEmfSection) -> bool:
    """Whether the phases of a capture are to be made equal."""
    return given.span == "electrical" if given.symmetric is None else given.symmetric


def read_saliency(
    section: MachineSection, phases: PhaseMachine, reading: Reading
) -> SalientPhaseMachine | None:
    """The machine with the harmonics of its inductances, None where they are constant.

    Raises:
        InputError: An order is listed twice, the inductances store no energy in some current, or
            the d axis that they are written about is not that of the back-EMF.
    """
    given = section.inductance_harmonics
    if given is None:
        return None
    orders = [harmonic.order for harmonic in given]
    for index, order in enumerate(orders):
        if order in orders[:index]:
            message = f"machine.inductance_harmonics: order {order} is listed twice; remove one"
            raise reading.document.error(message, (*_SALIENCY, index, "order"))
    lagging = phases.theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    lag = float(np.angle(np.mean(phases.flux * np.exp(-1j * lagging)) / 1j))
    if abs(lag) > _MOST_LAG:
        raise reading.document.error(
            "machine.inductance_harmonics are about the d axis, but order 1 of back_emf lies "
            f"{np.rad2deg(-lag):.3g} degrees behind it; write order 1 with phase: 0 deg",
            _SALIENCY,
            key=True,
        )
    own = [harmonic.amplitude.si for harmonic in given]
    mutual = [
        harmonic.amplitude.si if harmonic.mutual is None else harmonic.mutual.si
        for harmonic in given
    ]
    with reading.document.at(_SALIENCY, key=True):
        machine = SalientPhaseMachine.from_harmonics(phases, orders, own, mutual)
    l_d, l_q = (format_quantity(value, "H") for value in machine.dq_inductances)
    reading.remarks.append(
        "the dq values of the machine are means over the angle: psi_pm of the fundamental "
        f"{format_quantity(phases.psi_pm, 'Wb')}, l_d {l_d}, l_q {l_q}"
    )
    return machine


def _written(
    given: BackEmfSection, pole_pairs: int, reading: Reading
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Orders of the electrical angle, amplitudes in V s/rad and phases in rad of the harmonics
    as written, shapes (H,).
    """
    harmonics = given.harmonics or ()
    path: KeyPath = (*_BACK_EMF_PATH, "harmonics")
    if given.span == "mechanical":
        raise reading.document.error(
            "machine.back_emf.span is that of a capture; harmonics of pole pairs that differ are "
            "written with mechanical_order",
            (*_BACK_EMF_PATH, "span"),
        )
    orders = _orders(harmonics, pole_pairs, path, reading)
    if 1 not in orders or harmonics[orders.index(Fraction(1))].amplitude is None:
        raise reading.document.error(
            "machine.back_emf.harmonics needs order 1 with its amplitude; write {order: 1, "
            "amplitude: 0.2 Wb}",
            path,
        )
    base = _amplitude(harmonics[orders.index(Fraction(1))])
    amplitudes = []
    for index, harmonic in enumerate(harmonics):
        if (harmonic.amplitude is None) == (harmonic.share is None):
            message = "machine.back_emf: write either amplitude or share of each harmonic"
            raise reading.document.error(message, (*path, index))
        amplitudes.append(
            _amplitude(harmonic) if harmonic.share is None else harmonic.share.si * base
        )
    phases = [si_of(harmonic.phase) or 0.0 for harmonic in harmonics]
    order = np.array([float(order) for order in orders])
    return order, np.array(amplitudes), np.array(phases)


def _orders(
    harmonics: Sequence[HarmonicSection], pole_pairs: int, path: KeyPath, reading: Reading
) -> list[Fraction]:
    """Orders of the electrical angle, each once."""
    orders: list[Fraction] = []
    for index, harmonic in enumerate(harmonics):
        if (harmonic.order is None) == (harmonic.mechanical_order is None):
            message = (
                "machine.back_emf: write either order or mechanical_order of each harmonic, e.g. "
                "{order: 3, share: 12 %}"
            )
            raise reading.document.error(message, (*path, index))
        key = "mechanical_order" if harmonic.order is None else "order"
        order = (
            Fraction(harmonic.mechanical_order or 0, pole_pairs)
            if harmonic.order is None
            else Fraction(harmonic.order)
        )
        if order in orders:
            raise reading.document.error(
                f"machine.back_emf: order {order} is listed twice", (*path, index, key)
            )
        if order > _MOST_ORDER:
            raise reading.document.error(
                f"machine.back_emf: mechanical_order {harmonic.mechanical_order} is order "
                f"{float(order):g} of the electrical angle; write at most "
                f"{_MOST_ORDER * pole_pairs}",
                (*path, index, key),
            )
        orders.append(order)
    return orders


def _amplitude(harmonic: HarmonicSection) -> float:
    entry = harmonic.amplitude
    return 0.0 if entry is None else datasheet.peak_flux(entry.si, entry.kind or "peak")


def _captured(
    given: BackEmfSection, pole_pairs: int, reading: Reading
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Orders (H,), amplitudes in V s/rad and phases in rad, shapes (3, H), of a capture."""
    # Reading captures needs much that other designs do not.
    from dqforge.machines.back_emf.capture import analyse
    from dqforge.machines.back_emf.columns import CaptureOptions, read_captures

    names, path = _names(given)
    options = CaptureOptions(
        connection=given.connection,
        scale=given.scale,
        pole_pairs=pole_pairs,
        interval=si_of(given.interval),
    )
    try:
        capture = read_captures(
            names, lambda name: reading.read_beside(name, path), reading.is_beside, options
        )
        result = analyse(capture, pole_pairs=pole_pairs, harmonics=given.highest_order)
    except InputError as error:
        if error.line is not None:
            raise
        source = error.source or names[0]
        about = error.message if source in error.message else f"{source}: {error.message}"
        raise reading.document.error(f"machine.back_emf: {about}", path) from None
    source = ", ".join(names)
    reading.remarks.extend(f"{source}: {finding}" for finding in result.findings)
    pairs = result.pole_pairs
    if given.span == "electrical":
        if pairs is not None and pairs.finding:
            reading.remarks.append(f"{source}: {pairs.finding}")
        return result.orders.astype(np.float64), result.amplitudes, result.phases
    if pairs is None:
        why = (
            f"machine.back_emf.span: {source} is one voltage between two wires, which does not "
            "tell what the pole pairs differ by; write span: electrical"
            if len(capture.voltages) == 1
            else _not_covered(source, result.periods, pole_pairs)
        )
        raise reading.document.error(why, (*_BACK_EMF_PATH, "span"))
    if not pairs.differ:
        reading.remarks.append(
            f"{source}: what the pole pairs differ by, up to {pairs.spread:.1%}, is no more than "
            "its uncertainty; back_emf.span: electrical has less noise"
        )
    if pairs.orders[-1] < min(given.highest_order, result.orders[-1]):
        reading.remarks.append(
            f"{source}: over the mechanical turn harmonics up to order {pairs.orders[-1]:.3g} are "
            "taken"
        )
    return pairs.orders, pairs.amplitudes, pairs.phases


def _not_covered(source: str, periods: float, pole_pairs: int) -> str:
    """Why a capture has no mechanical span."""
    if pole_pairs == 1:
        return (
            "machine.back_emf.span: with one pole pair the mechanical turn is the electrical "
            "period; leave span out"
        )
    return (
        f"machine.back_emf.span: {source} does not cover a mechanical turn: it shows "
        f"{periods:.3g} electrical periods of {pole_pairs}; capture a whole turn, or write "
        "span: electrical"
    )


def _names(given: BackEmfSection) -> tuple[tuple[str, ...], KeyPath]:
    """Names of a capture's files, and the key that holds them."""
    if given.file is not None:
        return (given.file,), (*_BACK_EMF_PATH, "file")
    return given.files or (), (*_BACK_EMF_PATH, "files")
