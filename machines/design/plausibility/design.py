"""Values of a design that are possible each, but not together: held against
what drives usually have.

Every figure is formed from several entries, such as the drop over the resistance as a share of the
voltage, so that a wrong unit or kind shows in some of them. The ranges are wide: between a servo
motor of 50 W and a traction drive of 1 MW each holds with room to spare. What lies outside is not
refused, but told (docs/reference/inputs.md lists the figures).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.datasheet import peak_current
from dqforge.machines.design.design import Design
from dqforge.machines.design.plausibility.control import control_figures
from dqforge.machines.design.plausibility.devices import device_figures
from dqforge.machines.design.plausibility.figures import Figure, sentences
from dqforge.machines.design.plausibility.scale import Scale
from dqforge.machines.design.plausibility.scenario import scenario_figures
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.dq_machines.torque_limit import largest_torque_within
from dqforge.machines.entries.rules import si_of


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
        *control_figures(design, scale),
        *scenario_figures(design, scale),
    ]
    return sentences(figures)


def scale_of(design: Design) -> Scale:
    """Sizes that figures are shares of."""
    machine, i_max = design.machine, design.i_max
    part = np.array([i_max * math.sqrt(0.125)])
    psi = float(np.hypot(*machine.flux(-part, part))[0])
    if machine.psi_pm == 0.0:
        psi = max(psi, float(np.hypot(*machine.flux(part, part))[0]))
    voltage = design.inverter.v_dc / math.sqrt(3.0)
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
                "inductance_d times the current limit over it",
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
