"""Values of a design that are possible each, but not together: held against
what drives usually have.

Every figure is formed from several entries, such as the drop over the resistance as a share of the
voltage, so that a wrong unit or kind shows in some of them. The ranges are wide: between a servo
motor of 50 W and a traction drive of 1 MW each holds with room to spare. What lies outside is not
refused, but told (docs/reference/inputs.md lists the figures).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design, peak_current
from dqforge.machines.design.plausible_figures import Figure, device_figures, sentences
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.settings import ToleranceName
from dqforge.machines.dq_machines.synchronous import largest_torque_within
from dqforge.machines.entries.rules import si_of
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage


def implausibilities(design: Design, sections: DesignFile) -> list[str]:
    """Sentences on figures that no usual drive has, each with the key, the
    figure and what is usual.
    """
    scale = scale_of(design)
    figures = [
        *_machine(design, scale),
        *_mechanics(design, scale),
        *_losses(design, scale),
        *_rated(sections, design, scale),
        *_temperatures(sections, design, scale),
        *_inverter(design, scale),
        *device_figures(design.inverter),
        *control_figures(design, scale, sections),
        *scenario_figures(design, scale),
    ]
    return sentences([_as_typed(figure, sections) for figure in figures])


# Other ways to state an entry, of which a design has one.
_OTHER_WAYS = {
    "magnet_flux": ("kv", "back_emf_constant", "torque_constant"),
    "inductance_d": ("inductance",),
    "inductance_q": ("inductance",),
    "pole_pairs": ("poles",),
}


def _as_typed(figure: Figure, sections: DesignFile) -> Figure:
    """A figure under the key that the design has: kv, where the magnet flux is made of that."""
    section, _, name = figure.key.rpartition(".")
    typed = sections.machine.model_fields_set
    if section != "machine" or name in typed:
        return figure
    ways = (way for way in _OTHER_WAYS.get(name, ()) if way in typed)
    return replace(figure, key=f"{section}.{next(ways, name)}")


def scale_of(design: Design) -> Scale:
    """Sizes that figures are shares of."""
    machine, i_max = design.machine, design.i_max
    part = np.array([i_max * math.sqrt(0.125)])
    psi = float(np.hypot(*machine.flux(-part, part))[0])
    if machine.psi_pm == 0.0:
        psi = max(psi, float(np.hypot(*machine.flux(part, part))[0]))
    voltage = linear_voltage(design.inverter.v_dc)
    return Scale(
        voltage=voltage,
        current=i_max,
        flux=max(psi, 1e-12),
        base_speed=voltage / (machine.pole_pairs * max(psi, 1e-12)),
        torque=largest_torque_within(machine, i_max),
        power=1.5 * voltage * i_max,
        top_speed=machine.omega_m_max,
    )


def _machine(design: Design, scale: Scale) -> list[Figure]:
    """Resistance, inductances and flux against voltage, current and each other."""
    machine, i_max = design.machine, scale.current
    least = min(machine.l_d, machine.l_q)
    figures = [
        Figure(
            "machine.resistance",
            "the drop over it at the current limit, over v_dc/sqrt(3),",
            machine.r_s * i_max / scale.voltage,
            "%",
            1e-4,
            0.5,
        ),
        Figure(
            "machine.resistance",
            "the time constant of the winding, smaller inductance over resistance,",
            least / machine.r_s,
            "s",
            20e-6,
            1.0,
        ),
        Figure(
            "machine.inductance_q",
            "its ratio to inductance_d",
            machine.l_q / machine.l_d,
            "",
            0.05,
            20.0,
        ),
        Figure(
            "machine.inductance_d",
            "the current ripple v_dc/(8 L f_sw), over the current limit,",
            design.inverter.v_dc / (8.0 * least * design.inverter.f_sw) / i_max,
            "%",
            0.0,
            1.0,
        ),
        Figure(
            "machine.pole_pairs",
            "the number of pole pairs",
            float(machine.pole_pairs),
            "",
            1.0,
            40.0,
        ),
    ]
    if machine.psi_pm > 0.0:
        share = machine.l_d * i_max / machine.psi_pm
        figures.append(
            Figure(
                "machine.magnet_flux",
                "the inductance times the current limit, over the magnet flux,",
                share,
                "",
                2e-3,
                20.0,
            )
        )
    return figures


def _mechanics(design: Design, scale: Scale) -> list[Figure]:
    """Speeds, inertia and friction."""
    machine, figures = design.machine, []
    speed = scale.top_speed if scale.top_speed is not None else scale.base_speed
    if scale.top_speed is not None:
        frequency = machine.pole_pairs * speed / (2.0 * math.pi)
        figures += [
            Figure(
                "machine.max_speed",
                "its ratio to the base speed, where the voltage is used up,",
                speed / scale.base_speed,
                "",
                0.03,
                20.0,
            ),
            Figure(
                "machine.max_speed", "the electrical frequency at it", frequency, "Hz", 1.0, 5e3
            ),
            Figure("machine.max_speed", "the speed", speed, "rpm", 1.0, 200e3 * math.pi / 30.0),
            Figure(
                "machine.magnet_flux",
                "the back-EMF at max_speed over v_dc/sqrt(3)",
                machine.pole_pairs * speed * machine.psi_pm / scale.voltage,
                "",
                0.0,
                8.0,
            ),
        ]
    if machine.inertia is not None:
        seconds = machine.inertia * speed / scale.torque
        what = "the time from rest to the largest speed with the largest torque"
        figures.append(Figure("machine.inertia", what, seconds, "s", 1e-3, 300.0))
    drag = machine.friction * speed / scale.torque
    what = "the friction torque at the largest speed, over the largest torque,"
    figures.append(Figure("machine.friction", what, drag, "%", 0.0, 0.3))
    return figures


def _losses(design: Design, scale: Scale) -> list[Figure]:
    """Iron, AC and magnet loss at the speeds that they matter at."""
    loss, pole_pairs = design.machine_loss, design.machine.pole_pairs
    speed = scale.base_speed if scale.top_speed is None else min(scale.top_speed, scale.base_speed)
    omega = np.array(pole_pairs * speed)
    iron = float(loss.iron_factor(omega)) * scale.flux**2 / scale.power
    fast = pole_pairs * (speed if scale.top_speed is None else scale.top_speed)
    magnet = loss.magnet * fast * fast * scale.current**2 / scale.power
    power = "over the apparent power of the drive,"
    return [
        Figure(
            "machine.iron_loss", f"the iron loss at the base speed, {power}", iron, "%", 0.0, 0.2
        ),
        Figure(
            "machine.ac_resistance",
            "AC over DC resistance at the largest speed",
            float(loss.copper_factor(np.array(fast))),
            "",
            1.0,
            10.0,
        ),
        Figure(
            "machine.magnet_loss",
            f"the magnet loss at the largest speed, {power}",
            magnet,
            "%",
            0.0,
            0.2,
        ),
    ]


def _rated(sections: DesignFile, design: Design, scale: Scale) -> list[Figure]:
    """Name plate against limits, and its current against its torque."""
    rated, figures = sections.machine.rated, []
    if rated.current is not None:
        kind, connection = rated.current.kind or "", sections.machine.connection
        current = peak_current(rated.current.si, kind, connection)
        what = "the current limit over the rated current"
        figures.append(Figure("machine.max_current", what, scale.current / current, "", 0.5, 10.0))
        if rated.torque is not None:
            made = largest_torque_within(design.machine, current) / rated.torque.si
            what = "the torque that it makes, over the rated torque,"
            figures.append(Figure("machine.rated.current", what, made, "", 0.75, 1.4))
    if rated.torque is not None:
        what = "the largest torque over the rated torque"
        figures.append(
            Figure("machine.rated.torque", what, scale.torque / rated.torque.si, "", 0.9, 20.0)
        )
    if rated.speed is not None:
        what = "its ratio to the base speed"
        figures.append(
            Figure("machine.rated.speed", what, rated.speed.si / scale.base_speed, "", 0.05, 10.0)
        )
    if rated.power is not None:
        what = "its share of the apparent power at v_dc and the current limit"
        figures.append(
            Figure("machine.rated.power", what, rated.power.si / scale.power, "%", 5e-3, 1.2)
        )
    return figures


def _temperatures(sections: DesignFile, design: Design, scale: Scale) -> list[Figure]:
    """Temperatures of winding and magnets, and their coefficients."""
    section, figures = sections.machine.temperature, []
    for key, low, high in (
        ("winding", -60.0, 250.0),
        ("winding_reference", -60.0, 200.0),
        ("winding_coolant", -60.0, 150.0),
        ("magnet", -60.0, 250.0),
        ("magnet_reference", -60.0, 200.0),
    ):
        value = si_of(getattr(section, key))
        if value is not None:
            figures.append(
                Figure(f"machine.temperature.{key}", "the temperature", value, "degC", low, high)
            )
    for key, low, high in (("copper_coefficient", 3e-3, 5e-3), ("magnet_coefficient", -5e-3, 0.0)):
        value = si_of(getattr(section, key))
        if value is not None:
            what = "the relative change per kelvin"
            figures.append(Figure(f"machine.temperature.{key}", what, value, "%", low, high))
    if design.winding is not None:
        rated = sections.machine.rated.current
        current = 0.5 * scale.current if rated is None else peak_current(rated.si, rated.kind or "")
        rise = 1.5 * design.machine.r_s * current**2 * design.winding.thermal_resistance
        where = "half the current limit" if rated is None else "rated current"
        what = f"the rise of the winding by its copper loss at {where}"
        figures.append(
            Figure("machine.temperature.winding_thermal_resistance", what, rise, "K", 1.0, 1000.0)
        )
    return figures


def _inverter(design: Design, scale: Scale) -> list[Figure]:
    """Switching, limits and temperatures of the inverter."""
    inverter = design.inverter
    figures = [
        Figure("inverter.switching_frequency", "the frequency", inverter.f_sw, "Hz", 500.0, 500e3),
        Figure(
            "inverter.dead_time",
            "its share of the switching period",
            inverter.dead_time * inverter.f_sw,
            "%",
            0.0,
            0.1,
        ),
        Figure(
            "inverter.coolant_temperature",
            "the temperature",
            inverter.coolant_temperature,
            "degC",
            -60.0,
            130.0,
        ),
        Figure(
            "inverter.capacitor_esr",
            "the drop over it at the current limit, over v_dc,",
            inverter.capacitor_esr * scale.current / inverter.v_dc,
            "%",
            0.0,
            0.05,
        ),
    ]
    if inverter.dead_time > 0.0:
        figures.append(
            Figure("inverter.dead_time", "the time", inverter.dead_time, "s", 5e-9, 20e-6)
        )
    if inverter.i_max is not None:
        ratio = inverter.i_max / design.machine.i_max
        figures.append(
            Figure(
                "inverter.max_current", "its ratio to machine.max_current", ratio, "", 0.02, 50.0
            )
        )
    sensing = inverter.current_sensing
    if sensing is not None:
        what = "its full scale, over the current limit,"
        share = sensing.full_scale / scale.current
        figures.append(Figure("inverter.current_sensing", what, share, "", 1.0, 20.0))
    device = inverter.device
    if device is not None:
        margin = device.max_junction_temperature - inverter.coolant_temperature
        what = "what it leaves above the coolant"
        figures.append(
            Figure("inverter.device.max_junction_temperature", what, margin, "K", 10.0, 250.0)
        )
        what = "the temperature"
        hottest = device.max_junction_temperature
        figures.append(
            Figure("inverter.device.max_junction_temperature", what, hottest, "degC", 90.0, 250.0)
        )
        if device.kind == "igbt":
            what = "the frequency, with an IGBT,"
            figures.append(
                Figure("inverter.switching_frequency", what, inverter.f_sw, "Hz", 500.0, 80e3)
            )
            if inverter.dead_time > 0.0:
                what = "the time, with an IGBT,"
                figures.append(
                    Figure("inverter.dead_time", what, inverter.dead_time, "s", 0.2e-6, 20e-6)
                )
    return figures


# Figures of sampling, loops, observer and bases, see
# `dqforge.machines.design.plausibility`.

_TURN = 2.0 * math.pi


def control_figures(design: Design, scale: Scale, sections: DesignFile) -> list[Figure]:
    """Figures of the controllers and of what they are told; of bases, those of the file."""
    typed = sections.control.per_unit.model_fields_set
    return [
        *_current_loop(design),
        *_speed_loop(design),
        *_observer(design),
        *(each for each in _bases(design, scale) if each.key.rpartition(".")[2] in typed),
        *_tolerances(design),
        *_operation(design, scale),
    ]


def _current_loop(design: Design) -> list[Figure]:
    control, machine = design.control, design.machine
    loop, least = control.current_loop, min(machine.l_d, machine.l_q)
    figures = [
        Figure(
            "control.sampling_frequency",
            "the sampling period over the time constant of the winding",
            control.t_s * machine.r_s / least,
            "",
            0.0,
            1.0,
        )
    ]
    if loop.bandwidth is not None:
        share, what = loop.bandwidth * control.t_s / _TURN, "its share of the sampling frequency"
        figures.append(Figure("control.current_loop.bandwidth", what, share, "%", 5e-4, 0.25))
    if loop.kp is not None and loop.ki is not None:
        key, what = "control.current_loop.kp", "kp times the sampling period over the inductance"
        figures.append(Figure(key, what, loop.kp * control.t_s / least, "", 1e-3, 2.0))
        key, what = (
            "control.current_loop.ki",
            "the integral time kp/ki over the time constant of the winding",
        )
        if loop.ki > 0.0:
            figures.append(
                Figure(key, what, loop.kp / loop.ki * machine.r_s / least, "", 1e-2, 1e2)
            )
    return figures


def _speed_loop(design: Design) -> list[Figure]:
    control, loop = design.control, design.control.speed_loop
    if loop is None:
        return []
    sampling = 1.0 / (control.t_s * loop.ratio)
    figures = [
        Figure(
            "control.speed_loop.ratio",
            "the sampling frequency of the speed",
            sampling,
            "Hz",
            50.0,
            100e3,
        ),
        Figure("control.speed_loop.filter_time", "the time", loop.filter_time, "s", 0.0, 0.1),
    ]
    if loop.bandwidth is not None:
        key, share = "control.speed_loop.bandwidth", loop.bandwidth / (_TURN * sampling)
        figures.append(
            Figure(key, "its share of the sampling frequency of the speed", share, "%", 1e-4, 0.25)
        )
        if control.current_loop.bandwidth is not None:
            share = loop.bandwidth / control.current_loop.bandwidth
            figures.append(Figure(key, "its share of the current loop's", share, "%", 0.0, 0.5))
    return figures


def _observer(design: Design) -> list[Figure]:
    observer, figures = design.control.observer, []
    if observer is None:
        return []
    for name in ("pole", "bandwidth", "pll_bandwidth"):
        value = getattr(observer, name)
        if value is not None:
            key, what = f"control.observer.{name}", "the angular frequency"
            figures.append(Figure(key, what, value, "rad/s", 1.0, math.inf))
            share, what = value * design.control.t_s / _TURN, "its share of the sampling frequency"
            figures.append(Figure(key, what, share, "%", 0.0, 0.25))
    return figures


def _bases(design: Design, scale: Scale) -> list[Figure]:
    bases = design.control.bases
    speed = scale.base_speed if scale.top_speed is None else scale.top_speed
    return [
        Figure(
            "control.per_unit.current",
            "its ratio to the current limit",
            bases.current / scale.current,
            "",
            0.2,
            20.0,
        ),
        Figure(
            "control.per_unit.voltage",
            "its ratio to v_dc/sqrt(3)",
            bases.voltage / scale.voltage,
            "",
            0.2,
            20.0,
        ),
        Figure(
            "control.per_unit.speed",
            "its ratio to the largest speed",
            bases.speed / speed,
            "",
            0.05,
            50.0,
        ),
        Figure(
            "control.per_unit.torque",
            "its ratio to the largest torque",
            bases.torque / scale.torque,
            "",
            5e-3,
            50.0,
        ),
    ]


_LARGEST_DEVIATIONS: tuple[tuple[ToleranceName, float], ...] = (
    ("r_s", 0.7),
    ("l_d", 0.7),
    ("l_q", 0.7),
    ("psi_pm", 0.4),
    ("inertia", 0.8),
    ("v_dc", 0.5),
)


def _tolerances(design: Design) -> list[Figure]:
    box, figures = design.control.tolerances, []
    if box is None:
        return []
    for name, most in _LARGEST_DEVIATIONS:
        deviation = max(map(abs, box.limits(name)))
        figures.append(
            Figure(f"control.tolerances.{name}", "the deviation", deviation, "%", 0.0, most)
        )
    if design.inverter.dead_time > 0.0:
        share = max(map(abs, box.limits("dead_time"))) / design.inverter.dead_time
        figures.append(
            Figure(
                "control.tolerances.dead_time", "its share of the dead time", share, "%", 0.0, 1.0
            )
        )
    return figures


def _operation(design: Design, scale: Scale) -> list[Figure]:
    operation, fit, weakening = design.operation, design.fit, design.weakening
    figures = [
        Figure(
            "operation.voltage_margin",
            "the share kept free",
            operation.voltage_margin,
            "%",
            0.0,
            0.3,
        )
    ]
    if operation.omega_m is not None:
        ratio = operation.omega_m / scale.base_speed
        figures.append(
            Figure("operation.speed", "its ratio to the base speed", ratio, "", 0.05, 20.0)
        )
    if fit.torque_max is not None:
        share = fit.torque_max / scale.torque
        figures.append(
            Figure("fit.max_torque", "its share of the largest torque", share, "%", 0.05, 1.01)
        )
    if fit.budget is not None:
        for name in ("torque_error", "loss_penalty"):
            value = getattr(fit.budget, name)
            if value is not None:
                figures.append(Figure(f"fit.{name}", "the permitted error", value, "%", 1e-7, 0.1))
    if weakening is not None:
        ratio = weakening.omega_m / scale.base_speed
        figures += [
            Figure("field_weakening.speed", "its ratio to the base speed", ratio, "", 0.05, 20.0),
            Figure(
                "field_weakening.torque_error",
                "the permitted error",
                weakening.torque_error,
                "%",
                1e-6,
                0.1,
            ),
            Figure(
                "field_weakening.voltage_excess",
                "the permitted excess",
                weakening.voltage_excess,
                "%",
                1e-6,
                0.1,
            ),
        ]
    return figures


# Figures of points, simulation, waveform and choice of modulator, see
# `dqforge.machines.design.plausibility`.


def scenario_figures(design: Design, scale: Scale) -> list[Figure]:
    """Figures of what the drive is asked to do."""
    return [
        *_points(design, scale),
        *_simulation(design, scale),
        *_waveform(design, scale),
        *_choice(design, scale),
    ]


def _points(design: Design, scale: Scale) -> list[Figure]:
    figures = []
    for index, point in enumerate(() if design.losses is None else design.losses.points):
        share, what = abs(point.torque) / scale.torque, "its share of the largest torque"
        figures.append(Figure(f"losses.points[{index}].torque", what, share, "%", 0.0, 1.01))
        power, what = (
            abs(point.torque * point.omega_m) / scale.power,
            "torque times speed over the apparent power",
        )
        figures.append(Figure(f"losses.points[{index}].speed", what, power, "%", 0.0, 1.2))
    return figures


def _simulation(design: Design, scale: Scale) -> list[Figure]:
    scenario = design.simulation
    if scenario is None:
        return []
    sensor = scenario.sensor
    figures = [
        Figure(
            "simulation.duration",
            "the number of control periods",
            scenario.duration / design.control.t_s,
            "",
            10.0,
            2e7,
        ),
        Figure(
            "simulation.current_sensor.noise",
            "its share of the current limit",
            sensor.noise / scale.current,
            "%",
            0.0,
            0.1,
        ),
        Figure(
            "simulation.current_sensor.offset",
            "the largest share of the current limit",
            max(map(abs, sensor.offset)) / scale.current,
            "%",
            0.0,
            0.2,
        ),
    ]
    if sensor.bits > 0:
        ratio, what = sensor.full_scale / scale.current, "its ratio to the current limit"
        figures.append(Figure("simulation.current_sensor.full_scale", what, ratio, "", 0.8, 20.0))
    if scenario.dead_time is not None:
        share, what = scenario.dead_time * design.inverter.f_sw, "its share of the switching period"
        figures.append(Figure("simulation.dead_time", what, share, "%", 0.0, 0.1))
    speed = scale.base_speed if scale.top_speed is None else scale.top_speed
    start = abs(scenario.omega_m) / speed
    figures.append(
        Figure("simulation.initial.speed", "its ratio to the largest speed", start, "", 0.0, 2.0)
    )
    return figures


def _waveform(design: Design, scale: Scale) -> list[Figure]:
    settings, figures = design.waveform, []
    if settings.torque is not None:
        share, what = (
            settings.torque / scale.torque,
            "its ratio to the largest torque of the fundamental",
        )
        figures.append(Figure("waveform.torque", what, share, "", 1e-3, 2.0))
    figures.append(
        Figure("waveform.ripple", "the permitted ripple", settings.ripple, "%", 0.0, 0.5)
    )
    return figures


def _choice(design: Design, scale: Scale) -> list[Figure]:
    choice = design.modulation_choice
    if choice is None:
        return []
    figures = [
        Figure(
            "modulation_choice.max_frequency", "the frequency", choice.f_max, "Hz", 500.0, 500e3
        ),
        Figure(
            "modulation_choice.speed",
            "its ratio to the base speed",
            choice.omega_m / scale.base_speed,
            "",
            0.05,
            20.0,
        ),
    ]
    if choice.junction_max is not None:
        margin = choice.junction_max - design.inverter.coolant_temperature
        what = "what it leaves above the coolant"
        figures.append(
            Figure("modulation_choice.max_junction_temperature", what, margin, "K", 5.0, math.inf)
        )
    if choice.ripple_max is not None:
        share, what = choice.ripple_max / scale.current, "its share of the current limit"
        figures.append(Figure("modulation_choice.ripple_current", what, share, "%", 1e-4, 0.7))
    return figures


# Sizes of a drive that its figures are shares of.


@dataclass(frozen=True, slots=True)
class Scale:
    """Sizes of a drive, in SI units.

    Args:
        voltage: v_dc/sqrt(3), the largest phase voltage in the linear range.
        current: Current limit, peak of phase.
        flux: Flux linkage at half the current limit, 45 degrees ahead of the q axis.
        base_speed: Mechanical speed in rad/s at which this flux linkage uses the voltage up.
        torque: Largest torque within the current limit.
        power: Apparent power at voltage and current.
        top_speed: Largest mechanical speed in rad/s, or None.
    """

    voltage: float
    current: float
    flux: float
    base_speed: float
    torque: float
    power: float
    top_speed: float | None
