"""The back-EMF of a design file, as harmonics or from a capture beside the design,
and its saliency.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import datasheet
from dqforge.machines.design.reading import Reading
from dqforge.machines.design.sections.machine.back_emf_schema import BackEmfSection, HarmonicSection
from dqforge.machines.design.sections.machine.schema import MachineSection
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.places import KeyPath
from dqforge.machines.units.quantities import format_quantity

_PATH: KeyPath = ("machine", "back_emf")


_SALIENCY: KeyPath = ("machine", "inductance_harmonics")


_MOST_LAG = np.deg2rad(0.5)


def read_phase_machine(
    section: MachineSection, common: Mapping[str, Any], reading: Reading
) -> PhaseMachine:
    """Machine in phase quantities; ``common`` holds what all models share.

    Raises
    ------
    InputError
        The back-EMF is given twice or not at all, contradicts itself, or its capture is not sound.
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
        _written(given, reading)
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
        if given.harmonics is None and given.symmetric:
            machine = machine.symmetrised()
            reading.remarks.append(
                "machine.back_emf is the mean of the three phases and of both half waves"
            )
    if section.inductance_harmonics is None:
        reading.remarks.append(
            f"the dq values of the machine are those of the fundamental: psi_pm "
            f"{format_quantity(machine.psi_pm, 'Wb')}, l_d = l_q = "
            f"{format_quantity(l_s - m_s, 'H')}"
        )
    return machine


def read_saliency(
    section: MachineSection, phases: PhaseMachine, reading: Reading
) -> SalientPhaseMachine | None:
    """The machine with the harmonics of its inductances, None where they are constant.

    Raises
    ------
    InputError
        An order is listed twice, the inductances store no energy in some current, or the d axis
        that they are written about is not that of the back-EMF.
    """
    given = section.inductance_harmonics
    if given is None:
        return None
    orders = [harmonic.order for harmonic in given]
    for index, order in enumerate(orders):
        if order in orders[:index]:
            message = f"machine.inductance_harmonics: order {order} is listed twice; remove one"
            raise reading.document.error(message, (*_SALIENCY, index, "order"))
    theta = 2.0 * np.pi * np.arange(phases.angles) / phases.angles
    turns = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    lag = float(np.angle(np.mean(phases.flux * np.exp(-1j * turns)) / 1j))
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


def _written(given: BackEmfSection, reading: Reading) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Orders, amplitudes in V s/rad and phases in rad of the harmonics as written, shapes (H,)."""
    harmonics = given.harmonics or ()
    path: KeyPath = (*_PATH, "harmonics")
    orders = [harmonic.order for harmonic in harmonics]
    for index, order in enumerate(orders):
        if order in orders[:index]:
            raise reading.document.error(
                f"machine.back_emf: order {order} is listed twice", (*path, index, "order")
            )
    if 1 not in orders or harmonics[orders.index(1)].amplitude is None:
        raise reading.document.error(
            "machine.back_emf.harmonics needs order 1 with its amplitude; write {order: 1, "
            "amplitude: 0.2 Wb}",
            path,
        )
    base = _amplitude(harmonics[orders.index(1)])
    amplitudes = []
    for index, harmonic in enumerate(harmonics):
        if (harmonic.amplitude is None) == (harmonic.share is None):
            message = "machine.back_emf: write either amplitude or share of each harmonic"
            raise reading.document.error(message, (*path, index))
        amplitudes.append(
            _amplitude(harmonic) if harmonic.share is None else harmonic.share.si * base
        )
    phases = [si_of(harmonic.phase) or 0.0 for harmonic in harmonics]
    return np.array(orders, dtype=np.float64), np.array(amplitudes), np.array(phases)


def _amplitude(harmonic: HarmonicSection) -> float:
    entry = harmonic.amplitude
    return 0.0 if entry is None else datasheet.peak_flux(entry.si, entry.kind or "peak")


def _captured(
    given: BackEmfSection, pole_pairs: int, reading: Reading
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Orders (H,), amplitudes in V s/rad and phases in rad, shapes (3, H), of a capture."""
    # Reading captures needs much that other designs do not.
    from dqforge.machines.back_emf.capture import analyse
    from dqforge.machines.back_emf.columns import CaptureOptions
    from dqforge.machines.back_emf.files import read_captures

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
    reading.remarks.extend(f"{', '.join(names)}: {finding}" for finding in result.findings)
    return result.orders.astype(np.float64), result.amplitudes, result.phases


def _names(given: BackEmfSection) -> tuple[tuple[str, ...], KeyPath]:
    """Names of a capture's files, and the key that holds them."""
    if given.file is not None:
        return (given.file,), (*_PATH, "file")
    return given.files or (), (*_PATH, "files")
