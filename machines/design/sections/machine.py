"""The machine of a design file: constants, a flux map in files, or published saturation
coefficients; and checks of it as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import (
    AGREEMENT,
    ROUNDING_OF_DATA,
    FluxStatement,
    InputValue,
    Reading,
)
from dqforge.machines.design.sections.fit import FitSection
from dqforge.machines.design.sections.machine_files import (
    RIPPLE_LEFT,
    FluxMaps,
    check_connection,
    losses_told,
    read_flux_maps,
    read_phase_machine,
    read_saliency,
)
from dqforge.machines.design.sections.machine_schema import MachineSection, SaturationSection
from dqforge.machines.design.settings import bare_speed_hint
from dqforge.machines.dq_machines.flux_map import (
    FluxMap,
    SaturatedMachine,
    ScaledMachines,
    mirrored,
)
from dqforge.machines.dq_machines.saturation import SaturationModel
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, largest_torque_within
from dqforge.machines.entries.rules import Quantity, si_of
from dqforge.machines.errors import DqforgeError, InputError, about
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import MachineModel
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

# Relative change of the resistance of copper per kelvin, at 20 degC (IEC 60034-1 uses 1/(235 + 20)
# K).
_COPPER = 0.00393
_REFERENCE = 20.0

_NEEDED: dict[MachineModel, tuple[tuple[str, str], ...]] = {
    "linear": (("inductance_d", "1.61 mH"), ("inductance_q", "1.74 mH")),
    "flux-map": (("flux_map", "{file: map.csv}"),),
    "saturation": (("saturation", "{a_d0: ...}"),),
    "waveform": (
        ("self_inductance", "8 mH"),
        ("back_emf", "{harmonics: [{order: 1, amplitude: 0.2 Wb}]}"),
    ),
}

_OWN: dict[str, MachineModel] = {
    "inductance": "linear",
    "inductance_d": "linear",
    "inductance_q": "linear",
    "flux_map": "flux-map",
    "saturation": "saturation",
    "self_inductance": "waveform",
    "mutual_inductance": "waveform",
    "inductance_harmonics": "waveform",
    "back_emf": "waveform",
}


@dataclass(frozen=True, slots=True)
class MachineReading:
    """The machine in dq coordinates.

    ``phases`` holds it in phase quantities where its back-EMF is not sinusoidal.

    ``halves`` as in `Design`.
    """

    machine: Machine
    phases: AnyPhaseMachine | None = None
    halves: tuple[Machine, Machine] | None = None


def read_machine(section: MachineSection, reading: Reading) -> MachineReading:
    """Machine per phase and peak, at its operating temperatures.

    Raises:
        InputError: Keys are missing or belong to another model, constants contradict each other, or
            a flux map is not sound.
    """
    _check_model(section, reading)
    reading.connection = section.connection
    check_connection(section, reading)
    counts = [None if q is None else int(q.si) for q in (section.pole_pairs, section.poles)]
    with reading.document.at(
        ("machine", "poles") if section.poles else ("machine",), key=section.poles is None
    ):
        pole_pairs = datasheet.check_pole_counts(*counts)
    if section.poles is not None:
        reading.converted["machine.poles"] = (section.poles.si, f"{pole_pairs} pole pairs")
    common: Mapping[str, Any] = {
        "pole_pairs": pole_pairs,
        "r_s": _resistance(section, reading),
        "i_max": reading.machine_peak(section.max_current, ("machine", "max_current")),
        "inertia": si_of(section.inertia),
        "friction": si_of(section.friction) or 0.0,
        "omega_m_max": si_of(section.max_speed),
    }
    if section.rated.current is not None:
        reading.machine_peak(section.rated.current, ("machine", "rated", "current"))
    if section.back_emf is not None:
        phases = read_phase_machine(section, common, reading)
        salient = read_saliency(section, phases, reading)
        l_d, l_q = (phases.l_s - phases.m_s,) * 2 if salient is None else salient.dq_inductances
        return MachineReading(
            LinearMachine(l_d=l_d, l_q=l_q, psi_pm=phases.psi_pm, **common), salient or phases
        )
    if section.model == "linear":
        l_d, l_q = read_inductances(section, reading)
        linear = LinearMachine(
            l_d=l_d,
            l_q=l_q,
            psi_pm=_at_temperature(
                read_magnet_flux(section, pole_pairs, reading), section, reading
            ),
            **common,
        )
        return MachineReading(linear)
    _refuse_magnet_coefficient(section, reading)
    if section.saturation is not None:
        _refuse_constants(section, reading)
        coefficients = section.saturation
        maps = reading.recalled(
            (coefficients, common["i_max"]),
            lambda: FluxMaps(_saturation_map(coefficients, common["i_max"], reading)),
        )
    else:
        known = any(getattr(section, key) for key in FLUX_KEYS)
        expected = read_magnet_flux(section, pole_pairs, reading) if known else None
        at = section.connection, section.rated.current, section.temperature.magnet
        maps = reading.recalled(
            (section.flux_map, pole_pairs, expected, common["i_max"], *at),
            lambda: read_flux_maps(section, pole_pairs, reading, expected, common["i_max"]),
        )
        losses_told(maps, common["r_s"], reading)
    machine = _scaled(SaturatedMachine(flux_map=maps.symmetric, **common), section, reading)
    _check_range(machine, reading)
    if section.flux_map is None or section.flux_map.symmetry != "keep" or maps.whole is None:
        return MachineReading(machine)
    both = (maps.whole, mirrored(maps.whole))
    positive, negative = (
        _scaled(SaturatedMachine(flux_map=half, **common), section, None) for half in both
    )
    return MachineReading(machine, halves=(positive, negative))


def _check_model(section: MachineSection, reading: Reading) -> None:
    """Check that the keys are those of the model."""
    document = reading.document
    for key, model in _OWN.items():
        if getattr(section, key) is not None and model != section.model:
            message = (
                f"machine.{key} belongs to the model '{model}', this is '{section.model}'; write "
                f"model: {model}"
            )
            other = ", or remove the key"
            if section.model == "waveform" and model == "linear":
                value = getattr(section, key)
                kind = f" {value.kind}" if value.kind_given else ""
                other = (
                    f", or in its place self_inductance: {value.text}{kind}, with "
                    "mutual_inductance: ... where it was measured"
                )
            raise document.error(message + other, ("machine", key), key=True)
    if section.map_scale is not None and section.model not in ("flux-map", "saturation"):
        raise document.error(
            "machine.map_scale scales the flux map of a machine that saturates, this is model "
            f"'{section.model}'; change its own constants, and remove the key",
            ("machine", "map_scale"),
            key=True,
        )
    if section.inductance is not None:
        return
    for key, example in _NEEDED[section.model]:
        if getattr(section, key) is None:
            raise document.error(
                f"machine needs the key '{key}'; write {key}: {example}"
                + ", or inductance: 1.6 mH for both axes" * (section.model == "linear"),
                ("machine",),
                key=True,
            )


def _scaled(
    machine: SaturatedMachine, section: MachineSection, reading: Reading | None
) -> SaturatedMachine:
    """The machine with the factors of its map, where it has any; ``reading`` takes the remark."""
    if section.map_scale is None:
        return machine
    names = ("magnet", "inductance_d", "inductance_q", "current")
    given = {name: si_of(getattr(section.map_scale, name)) for name in names}
    factors = {name: np.array([value]) for name, value in given.items() if value is not None}
    if reading is not None and factors:
        told = ", ".join(f"{name} {values[0]:g}" for name, values in factors.items())
        reading.remarks.append(f"the flux map is scaled (machine.map_scale): {told}")
        if machine.flux_map.ripple is not None:
            reading.remarks.append(f"{RIPPLE_LEFT} with map_scale")
    return ScaledMachines.varied(machine, 1, factors).machine(0)


def _resistance(section: MachineSection, reading: Reading) -> float:
    """Phase resistance in Ohm at the temperature of the winding."""
    path = "machine.resistance"
    value = reading.per_phase(section.resistance, path)
    temperature = section.temperature
    if temperature.winding is None:
        return value
    coefficient = si_of(temperature.copper_coefficient)
    reference = si_of(temperature.winding_reference)
    coefficient = _COPPER if coefficient is None else coefficient
    reference = _REFERENCE if reference is None else reference
    warm = value * (1.0 + coefficient * (temperature.winding.si - reference))
    if not warm > 0.0:
        raise reading.document.error(
            f"machine.temperature: the resistance at {temperature.winding.text} would be "
            f"{warm:.3g} Ohm; check the coefficient, e.g. 0.393 %/K",
            ("machine", "temperature", "copper_coefficient"),
        )
    before = reading.converted.get(path, (value, ""))[1]
    note = f"at {temperature.winding.text}, {coefficient * 100.0:.4g} %/K from {reference:g} degC"
    reading.converted[path] = (warm, f"{before}; {note}" if before else note)
    return warm


def _at_temperature(psi_pm: float, section: MachineSection, reading: Reading) -> float:
    """Magnet flux linkage in Wb at the temperature of the magnets."""
    temperature = section.temperature
    if temperature.magnet is None or psi_pm == 0.0:
        return psi_pm
    if temperature.magnet_coefficient is None:
        raise reading.document.error(
            "machine.temperature.magnet needs the coefficient of the magnets; write "
            "magnet_coefficient: -0.11 %/K (NdFeB) or -0.2 %/K (ferrite)",
            ("machine", "temperature", "magnet"),
            key=True,
        )
    reference = si_of(temperature.magnet_reference)
    reference = _REFERENCE if reference is None else reference
    coefficient = temperature.magnet_coefficient.si
    warm = psi_pm * (1.0 + coefficient * (temperature.magnet.si - reference))
    if not warm > 0.0:
        raise reading.document.error(
            "machine.temperature: nothing would be left of the magnet flux at "
            f"{temperature.magnet.text}; check the coefficient, e.g. -0.11 %/K",
            ("machine", "temperature", "magnet_coefficient"),
        )
    reading.remarks.append(
        f"the magnet flux is {format_quantity(warm, 'Wb')} at {temperature.magnet.text} "
        f"({format_quantity(psi_pm, 'Wb')} at {reference:g} degC)"
    )
    return warm


def _refuse_magnet_coefficient(section: MachineSection, reading: Reading) -> None:
    temperature = section.temperature
    several = section.flux_map is not None and section.flux_map.files is not None
    if temperature.magnet_coefficient is not None or (
        temperature.magnet is not None and not several
    ):
        raise reading.document.error(
            "machine.temperature: the flux linkages of a saturated machine do not follow one "
            "coefficient; write flux_map.files with a magnet_temperature each, or leave the "
            "magnet's temperature out",
            ("machine", "temperature"),
            key=True,
        )


def _refuse_constants(section: MachineSection, reading: Reading) -> None:
    for key in FLUX_KEYS:
        if getattr(section, key) is not None:
            message = (
                f"machine.{key} does not belong to the model 'saturation', whose coefficients say "
                "it; remove the key"
            )
            raise reading.document.error(message, ("machine", key), key=True)


@about("machine.saturation")
def _saturation_map(section: SaturationSection, i_max: float, reading: Reading) -> FluxMap:
    bridge = section.bridge
    try:
        model = SaturationModel(
            a_d0=section.a_d0,
            a_dd=section.a_dd,
            s=section.s,
            a_q0=section.a_q0,
            a_qq=section.a_qq,
            t=section.t,
            a_dq=section.a_dq,
            u=section.u,
            v=section.v,
            psi_n=bridge.psi_n if bridge else 0.0,
            a_b=bridge.a_b if bridge else 0.0,
            a_bp=bridge.a_bp if bridge else 0.0,
            k_q=bridge.k_q if bridge else 0.0,
            bridge_exponent=bridge.w if bridge else 2.0,
        )
        return model.flux_map(i_max)
    except DqforgeError as error:
        raise reading.document.error(
            f"machine.saturation: {error}", ("machine", "saturation"), key=True
        ) from None


def _check_range(machine: SaturatedMachine, reading: Reading) -> None:
    """Refuse a current limit beyond the map, unless it may be left."""
    flux_map, i_max = machine.flux_map, machine.i_max
    if flux_map.hull is None:
        reach = min(max(-float(flux_map.i_d[0]), float(flux_map.i_d[-1])), float(flux_map.i_q[-1]))
    else:
        reach = flux_map.hull.size
    if i_max <= reach * (1.0 + 1e-6):
        _remark_on_the_region(machine, reading)
        return
    if flux_map.extrapolate:
        reading.remarks.append(
            f"machine.max_current {format_quantity(i_max, 'A')} lies beyond the flux map, which "
            f"ends at {format_quantity(reach, 'A')}: results there are extrapolated along its "
            "tangents"
        )
        return
    raise reading.document.error(
        f"machine.max_current {format_quantity(i_max, 'A')} (peak) lies beyond the flux map, which "
        f"ends at {format_quantity(reach, 'A')}; lower it, or write flux_map: extrapolate: true",
        ("machine", "max_current"),
    )


def _remark_on_the_region(machine: SaturatedMachine, reading: Reading) -> None:
    """Say where the data end within the current limit, and what that means for the
    currents that are chosen.
    """
    flux_map, i_max = machine.flux_map, machine.i_max
    region = flux_map.region
    if region.covers(i_max):
        return
    if flux_map.hull is None:
        where = f"covers i_d from {flux_map.i_d[0]:.4g} to {flux_map.i_d[-1]:.4g} A (peak)"
    else:
        nearest = max(region.reach, 0.0)
        where = (
            f"covers a region that ends {format_quantity(nearest, 'A')} (peak) from zero current "
            "at its nearest"
        )
    meant = (
        "results beyond are extrapolated along its tangents (extrapolate: true)"
        if flux_map.extrapolate
        else "operating points stay inside the map"
    )
    reading.remarks.append(
        f"the flux map {where}, the current limit is {format_quantity(i_max, 'A')}: {meant}"
    )


# Inductances of both axes, or the one that a data sheet has for both.


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


# Flux linkage of the magnets from the keys that imply it, once all agree.

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


# Checks of the machine as a whole: against its name plate, and of kept halves against the fit.


def check_machine(section: MachineSection, machine: Machine, document: YamlDocument) -> None:
    """Check the machine as a whole against its name plate; raises `InputError` with a position."""
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0 and machine.l_d == machine.l_q:
        raise document.error(
            "machine: no magnet flux and inductance_d equal to inductance_q, so it gives no "
            "torque; write magnet_flux or two different inductances",
            ("machine", "inductance_q"),
        )
    rated = section.rated
    torque, speed, power, frequency = map(
        si_of, (rated.torque, rated.speed, rated.power, rated.frequency)
    )
    if frequency is not None and speed is not None:
        with document.at(("machine", "rated", "frequency")):
            datasheet.check_rated_frequency(machine.pole_pairs, frequency, speed)
    if power is not None and torque is not None and speed is not None:
        with document.at(("machine", "rated", "power")):
            datasheet.check_rated_power(power, torque, speed)
    if rated.current is not None:
        current = datasheet.peak_current(
            rated.current.si, rated.current.kind or "", section.connection
        )
        _check_rated_current(current, machine, document)
    if torque is not None:
        with document.at(("machine", "rated", "torque")):
            datasheet.check_rated_torque(torque, largest_torque_within(machine, machine.i_max))
    most = machine.omega_m_max
    if (
        rated.speed is not None
        and most is not None
        and rated.speed.si > most * (1.0 + ROUNDING_OF_DATA)
    ):
        hint = bare_speed_hint(rated.speed)
        message = (
            f"machine.rated.speed {format_quantity(rated.speed.si, 'rpm')} is above max_speed; "
            f"{hint}"
        )
        raise document.error(message, ("machine", "rated", "speed"))


def _check_rated_current(current: float, machine: Machine, document: YamlDocument) -> None:
    if current <= machine.i_max * (1.0 + ROUNDING_OF_DATA):
        return
    raise document.error(
        f"machine.rated.current is {format_quantity(current, 'A')} peak, above max_current "
        f"{format_quantity(machine.i_max, 'A')} peak; check the kinds (peak or rms) of both",
        ("machine", "rated", "current"),
    )


def check_halves(machine: MachineSection, fit: FitSection, document: YamlDocument) -> None:
    """Refuse what cannot keep the halves of a flux map apart."""
    section = machine.flux_map
    if section is None or section.symmetry != "keep":
        return
    budget = any(part is not None for part in (fit.torque_error, fit.loss_penalty, fit.flash))
    if budget or fit.format in ("q15", "q31"):
        raise document.error(
            "machine.flux_map.symmetry: keep needs references in float32 of a given form; write "
            "fit: format: float32 and leave the budget out, or symmetry: average",
            ("machine", "flux_map", "symmetry"),
        )
