"""The back-EMF of a design file, as harmonics or from a capture beside the design,
and its saliency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import Reading
from dqforge.machines.design.sections.machine.schema import (
    BackEmfSection,
    HarmonicSection,
    MachineSection,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.places import KeyPath
from dqforge.machines.units.quantities import format_quantity

_PATH: KeyPath = ("machine", "back_emf")


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
            "machine.back_emf: write either harmonics, file or files", _PATH, key=True
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
    orders, amplitudes, phases = (
        _written(given, common["pole_pairs"], reading)
        if given.harmonics is not None
        else _captured(given, common["pole_pairs"], reading)
    )
    with reading.document.at(_PATH, key=True):
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
    path: KeyPath = (*_PATH, "harmonics")
    if given.span == "mechanical":
        raise reading.document.error(
            "machine.back_emf.span is that of a capture; harmonics of pole pairs that differ are "
            "written with mechanical_order",
            (*_PATH, "span"),
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
        raise reading.document.error(why, (*_PATH, "span"))
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
        return (given.file,), (*_PATH, "file")
    return given.files or (), (*_PATH, "files")
