"""Implausible designs: each is told with its key and figure, and no sound design is."""

from __future__ import annotations

import re

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.plausible_figures import MARK, Figure

BASE = catalogue.template().decode()


def told(text: str) -> list[str]:
    return [
        sentence
        for sentence in load_text(text.encode(), "d.yaml").assumptions
        if sentence.startswith(MARK)
    ]


def changed(*pairs: tuple[str, str]) -> str:
    text = BASE
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


NO_RATED = (
    "  rated:\n    torque: 0.47 N m\n    speed: 5000 rpm\n    current: {value: 1.6 A, kind: rms}\n",
    "",
)
NO_POINTS = (
    "    - {torque: 0.47 N m, speed: 1500 rpm}\n    - {torque: 0.47 N m, speed: 4000 rpm}\n",
    "    - {torque: 0.47 N m, speed: 40 rpm}\n",
)
FRICTION = "  friction: 40e-6 N m s\n"
CONTROL = "  sampling_frequency: 10 kHz      # default: the switching frequency\n"
SIMULATION = "simulation:\n  duration: 0.1 s\n  torque: {points: [{time: 0 s, torque: 0.1 N m}]}\n"
METHODS = "# bandwidth, damping, magnitude-optimum, symmetrical-optimum, optimised or given"
MAGNITUDE = f"    method: magnitude-optimum     {METHODS}\n"
SPEED = (
    "    method: symmetrical-optimum   # bandwidth, damping, symmetrical-optimum, optimised or "
    "given\n"
)
DEVICE = "    thermal_resistance: 2 K/W     # junction to coolant, per switch\n"
STRATEGY = "  strategy: mtpa                  # least current for the torque; id0: no d current\n"

CASES: dict[str, tuple[str, str, list[tuple[str, str]]]] = {
    "dead time of 40 %": ("inverter.dead_time", "40 %", [("dead_time: 1 us", "dead_time: 40 us")]),
    "currents beyond what is measured": (
        "inverter.current_sensing",
        "0.0129",
        [
            (
                "dead_time: 1 us",
                "dead_time: 1 us\n  current_sensing: {shunt: 1 Ohm, gain: 20, reference: 3.3 V}",
            )
        ],
    ),
    "junction limit below the coolant": (
        "inverter.device.max_junction_temperature",
        "-10 K",
        [(DEVICE, DEVICE + "    max_junction_temperature: 30 degC\n")],
    ),
    "900 Ohm at 180 V": (
        "machine.resistance",
        "5540 %",
        [("resistance: 2.35 Ohm", "resistance: 900 Ohm")],
    ),
    "l_q a thousand times l_d": (
        "machine.inductance_q",
        "1080",
        [("inductance_q: 1.74 mH", "inductance_q: 1.74 H")],
    ),
    "speed ratio of 100,000": (
        "control.speed_loop.ratio",
        "100 mHz",
        [("ratio: 10    ", "ratio: 100000")],
    ),
    "largest speed far above the base speed": (
        "machine.max_speed",
        "",
        [("max_speed: 5000 rpm", "max_speed: 500000 rpm")],
    ),
    "largest speed in another unit": (
        "machine.max_speed",
        "",
        [("max_speed: 5000 rpm", "max_speed: 50 rpm"), NO_RATED, NO_POINTS],
    ),
    "electrical frequency": (
        "machine.max_speed",
        "Hz",
        [("max_speed: 5000 rpm", "max_speed: 120000 rpm")],
    ),
    "back-EMF": ("machine.magnet_flux", "", [("max_speed: 5000 rpm", "max_speed: 60000 rpm")]),
    "tiny flux": (
        "machine.magnet_flux",
        "",
        [("magnet_flux: 0.06 Wb", "magnet_flux: 0.06 mWb"), NO_RATED],
    ),
    "winding without resistance": (
        "machine.resistance",
        "s",
        [("resistance: 2.35 Ohm", "resistance: 0.1 mOhm")],
    ),
    "winding without inductance": (
        "machine.inductance_d",
        "%",
        [
            ("inductance_d: 1.61 mH", "inductance_d: 16.1 uH"),
            ("inductance_q: 1.74 mH", "inductance_q: 17.4 uH"),
        ],
    ),
    "pole pairs": ("machine.poles", "60", [("poles: 6 ", "poles: 120")]),
    "inertia in another unit": (
        "machine.inertia",
        "s",
        [("inertia: 200e-6 kg m^2", "inertia: 200 kg m^2")],
    ),
    "inertia of nothing": (
        "machine.inertia",
        "s",
        [("inertia: 200e-6 kg m^2", "inertia: 1e-6 kg m^2")],
    ),
    "friction": ("machine.friction", "%", [(FRICTION, "  friction: 0.04 N m s\n")]),
    "current limit and rated current": (
        "machine.max_current",
        "",
        [("value: 1.6 A, kind: rms", "value: 160 mA, kind: rms")],
    ),
    "rated current and rated torque": (
        "machine.rated.current",
        "0.65",
        [("current: {value: 1.6 A, kind: rms}", "current: {value: 0.8 A, kind: rms}")],
    ),
    "rated torque": (
        "machine.rated.torque",
        "",
        [("    torque: 0.47 N m\n    speed", "    torque: 0.47 N cm\n    speed")],
    ),
    "rated speed": (
        "machine.rated.speed",
        "",
        [("    speed: 5000 rpm\n    current", "    speed: 50 rpm\n    current")],
    ),
    "rated power": (
        "machine.rated.power",
        "%",
        [
            (
                "    torque: 0.47 N m\n    speed: 5000 rpm\n    current",
                "    power: 246 kW\n    current",
            )
        ],
    ),
    "inverter current": (
        "inverter.max_current",
        "",
        [("max_current: 10 A  ", "max_current: 10 kA ")],
    ),
    "switching frequency": (
        "inverter.switching_frequency",
        "Hz",
        [
            ("switching_frequency: 10 kHz", "switching_frequency: 10 MHz"),
            (CONTROL, "  sampling_frequency: 1 MHz\n"),
            ("dead_time: 1 us", "dead_time: 10 ns"),
        ],
    ),
    "dead time in another unit": (
        "inverter.dead_time",
        "ps",
        [("dead_time: 1 us", "dead_time: 0.001 ns")],
    ),
    "dead time of an IGBT": (
        "inverter.dead_time",
        "ns",
        [
            ("dead_time: 1 us", "dead_time: 50 ns"),
            ("kind: mosfet       ", "kind: igbt\n    on_voltage: 1 V\n    diode_voltage: 1 V  "),
        ],
    ),
    "fast IGBT": (
        "inverter.switching_frequency",
        "200 kHz",
        [
            ("switching_frequency: 10 kHz", "switching_frequency: 200 kHz"),
            (CONTROL, "  sampling_frequency: 100 kHz\n"),
            ("dead_time: 1 us", "dead_time: 300 ns"),
            ("kind: mosfet       ", "kind: igbt\n    on_voltage: 1 V\n    diode_voltage: 1 V  "),
        ],
    ),
    "coolant": (
        "inverter.coolant_temperature",
        "degC",
        [("coolant_temperature: 40 degC", "coolant_temperature: 150 degC")],
    ),
    "capacitor": (
        "inverter.capacitor_esr",
        "%",
        [("coolant_temperature: 40 degC", "coolant_temperature: 40 degC\n  capacitor_esr: 10 Ohm")],
    ),
    "bandwidth of the current": (
        "control.current_loop.bandwidth",
        "%",
        [(MAGNITUDE, "    method: bandwidth\n    bandwidth: 1 Hz\n")],
    ),
    "bandwidths in the wrong order": (
        "control.speed_loop.bandwidth",
        "%",
        [
            (MAGNITUDE, "    method: bandwidth\n    bandwidth: 50 Hz\n"),
            (SPEED, "    method: bandwidth\n    bandwidth: 80 Hz\n"),
            ("    spread: 3\n", ""),
        ],
    ),
    "given kp": (
        "control.current_loop.kp",
        "",
        [(MAGNITUDE, "    method: given\n    kp: 1.1 mV/A\n    ki: 1 V/(A s)\n")],
    ),
    "given ki": (
        "control.current_loop.ki",
        "",
        [(MAGNITUDE, "    method: given\n    kp: 1.1 V/A\n    ki: 0.01 V/(A s)\n")],
    ),
    "speed filter": (
        "control.speed_loop.filter_time",
        "s",
        [("filter_time: 0 s", "filter_time: 0.5 s")],
    ),
    "pole of the observer": (
        "control.observer.pole",
        "%",
        [("pole: 400 rad/s", "pole: 40000 rad/s")],
    ),
    "base current": (
        "control.per_unit.current",
        "",
        [
            (
                (
                    "  # per_unit: {current: 6.4 A, voltage: 103.9 V, speed: 5000 rpm, torque: 1.7 "
                    "N m}"
                ),
                "  per_unit: {current: 640 A}",
            )
        ],
    ),
    "base voltage": (
        "control.per_unit.voltage",
        "",
        [
            (
                (
                    "  # per_unit: {current: 6.4 A, voltage: 103.9 V, speed: 5000 rpm, torque: 1.7 "
                    "N m}"
                ),
                "  per_unit: {voltage: 10 V}",
            )
        ],
    ),
    "base speed": (
        "control.per_unit.speed",
        "",
        [
            (
                (
                    "  # per_unit: {current: 6.4 A, voltage: 103.9 V, speed: 5000 rpm, torque: 1.7 "
                    "N m}"
                ),
                "  per_unit: {speed: 5 rpm}",
            )
        ],
    ),
    "base torque": (
        "control.per_unit.torque",
        "",
        [
            (
                (
                    "  # per_unit: {current: 6.4 A, voltage: 103.9 V, speed: 5000 rpm, torque: 1.7 "
                    "N m}"
                ),
                "  per_unit: {torque: 1.7 mN m}",
            )
        ],
    ),
    "tolerance of the resistance": (
        "control.tolerances.r_s",
        "85 %",
        [
            (STRATEGY.split("\n", maxsplit=1)[0], "  strategy: mtpa"),
            ("operation:\n", "  tolerances: {r_s: 85 %}\noperation:\n"),
        ],
    ),
    "tolerance of the flux": (
        "control.tolerances.psi_pm",
        "80 %",
        [("operation:\n", "  tolerances: {psi_pm: 80 %}\noperation:\n")],
    ),
    "tolerance of the dead time": (
        "control.tolerances.dead_time",
        "500 %",
        [("operation:\n", "  tolerances: {dead_time: 5 us}\noperation:\n")],
    ),
    "voltage margin": (
        "operation.voltage_margin",
        "60 %",
        [(STRATEGY, STRATEGY + "  speed: 4000 rpm\n  voltage_margin: 60 %\n")],
    ),
    "speed of the references": (
        "operation.speed",
        "",
        [(STRATEGY, STRATEGY + "  speed: 40 rpm\n")],
    ),
    "end of the domain": (
        "fit.max_torque",
        "%",
        [("exact_at_zero: true", "exact_at_zero: true\n  max_torque: 1 mN m")],
    ),
    "permitted error": (
        "fit.torque_error",
        "15 %",
        [
            (
                (
                    "  form: torque-exact              # polynomial, even-odd, torque-exact or "
                    "closed-form\n"
                ),
                "",
            ),
            ("  degree: 2                       # 1 to 6\n", "  torque_error: 15 %\n"),
            ("  segments: 1                     # 1 to 4\n", ""),
            ("  breakpoint_mode: shared         # or own: one set per axis\n", ""),
        ],
    ),
    "temperature of the winding": (
        "machine.temperature.winding_coolant",
        "degC",
        [
            (
                FRICTION,
                FRICTION
                + (
                    "  temperature: {winding: 60 degC, winding_coolant: 180 degC, "
                    "winding_thermal_resistance: 1 K/W}\n"
                ),
            )
        ],
    ),
    "copper": (
        "machine.temperature.copper_coefficient",
        "%",
        [
            (
                FRICTION,
                FRICTION + "  temperature: {winding: 60 degC, copper_coefficient: 0.0393 %/K}\n",
            )
        ],
    ),
    "magnets that gain with heat": (
        "machine.temperature.magnet_coefficient",
        "%",
        [(FRICTION, FRICTION + "  temperature: {magnet: 60 degC, magnet_coefficient: 0.11 %/K}\n")],
    ),
    "winding to coolant": (
        "machine.temperature.winding_thermal_resistance",
        "K",
        [(FRICTION, FRICTION + "  temperature: {winding_thermal_resistance: 200 K/W}\n")],
    ),
    "iron loss": (
        "machine.iron_loss",
        "%",
        [(FRICTION, FRICTION + "  iron_loss: {frequency: 250 Hz, flux: 0.06 Wb, eddy: 2 kW}\n")],
    ),
    "ac resistance": (
        "machine.ac_resistance",
        "",
        [(FRICTION, FRICTION + "  ac_resistance: {ratio: 2, frequency: 10 Hz}\n")],
    ),
    "magnet loss": (
        "machine.magnet_loss",
        "%",
        [(FRICTION, FRICTION + "  magnet_loss: {loss: 2 kW, frequency: 250 Hz, current: 6.4 A}\n")],
    ),
    "point of comparison": (
        "losses.points[1].speed",
        "%",
        [("{torque: 0.47 N m, speed: 4000 rpm}", "{torque: 470 N m, speed: 4000 rpm}")],
    ),
    "field weakening": (
        "field_weakening.torque_error",
        "20 %",
        [("fit:\n", "field_weakening: {speed: 4000 rpm, torque_error: 20 %}\nfit:\n")],
    ),
    "simulated sensor": (
        "simulation.current_sensor.full_scale",
        "",
        [
            (
                "losses:\n",
                SIMULATION + "  current_sensor: {bits: 12, full_scale: 1 A}\nlosses:\n",
            )
        ],
    ),
    "simulated noise": (
        "simulation.current_sensor.noise",
        "%",
        [
            (
                "losses:\n",
                SIMULATION + "  current_sensor: {noise: 5 A}\nlosses:\n",
            )
        ],
    ),
    "simulated time": (
        "simulation.duration",
        "",
        [
            (
                "losses:\n",
                (
                    "simulation:\n  duration: 0.2 ms\n"
                    "  torque: {points: [{time: 0 s, torque: 0.1 N m}]}\nlosses:\n"
                ),
            )
        ],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_implausible_entry_is_told_with_its_figure(name: str) -> None:
    key, figure, pairs = CASES[name]
    found = told(changed(*pairs))
    mine = [sentence for sentence in found if sentence.startswith(f"{MARK}{key}: ")]
    assert mine, found
    assert any(
        re.search(rf" is {re.escape(figure)}|{re.escape(figure)}, usual is ", sentence)
        for sentence in mine
    ), mine
    assert all("usual is" in sentence and sentence.isprintable() for sentence in mine)


@pytest.mark.parametrize("name", [*catalogue.names(), "template"])
def test_sound_designs_are_not_remarked_on(name: str) -> None:
    assert told(BASE) == []
    if name != "template":
        assert [text for text in catalogue.load(name).assumptions if text.startswith(MARK)] == []


def test_ends_of_a_range_are_usual() -> None:
    low, high = (Figure("a.b", "the share", value, "%", 0.1, 0.5) for value in (0.1, 0.5))
    assert low.is_usual
    assert high.is_usual
    beyond = Figure("a.b", "the share", 0.51, "%", 0.1, 0.5)
    assert not beyond.is_usual
    assert (
        beyond.sentence()
        == f"{MARK}a.b: the share is 51 %, usual is 10 % to 50 %; check the value and its unit"
    )
    assert "usual is at most 50 %" in Figure("a.b", "it", 0.6, "%", 0.0, 0.5).sentence()
    assert "usual is at least 5 K" in Figure("a.b", "it", 1.0, "K", 5.0, float("inf")).sentence()
