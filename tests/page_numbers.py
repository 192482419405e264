"""Tables of the documentation whose figures are made from what `dqforge export` emits.

A page holds a table behind a line ``<!-- numbers: NAME -->``. As a program,
``python tests/page_numbers.py [NAME...]`` makes the tables of those names, or all, and writes them
into their pages; `tests/test_page_numbers.py` holds pages against what is made, a table drawn per
commit by default and all of them in the campaign.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from benchmarks import sensorless_samples
from benchmarks.sensorless_samples import KEPT, METHODS, read
from fixed_phase_loop import Loop
from interrupt_steps import interrupts
from learned_parameters import parameter_estimators
from learned_speed import speed_controllers
from measuring_mistakes import measuring
from phase_drives import near_sinusoidal

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.sections.observer import SPREAD
from dqforge.machines.names import Core, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import Scenario, constant
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.current_feedback.regulator_runs import working_points
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.phase_control.design import resampled, shape_error
from dqforge.optimizer.phase_control.limited_shapes import limited_torques
from dqforge.optimizer.phase_control.phase_controller import PhaseShape, limit_at
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.run import emitted_files
from dqforge.reports.simulation.feedback_run import closed_loads
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import simulate_many, simulator
from dqforge.reports.verification.measured_cost import CallCost, cost_on_target

DOCS = Path(__file__).resolve().parent.parent / "docs"
PHASES = "paper002-phase-waveforms"
SPEEDS = (75.0, 750.0, 1800.0)

CORES: dict[Core, str] = {
    "cortex-m4": "M4F", "cortex-m33": "M33", "cortex-m7": "M7", "cortex-m0plus": "M0+",
}  # fmt: skip

# Drives of current-feedback PWM, with a device where they have none.
CLOSED_DRIVES = {
    "paper001-pmsm-bench": (),
    "thor-pmsyrm-5k": ("inverter.device.name=infineon-ff200r12ke3",),
}

Rows = Iterator[tuple[str, ...]]


@dataclass(frozen=True)
class Numbers:
    """A table of a page: what makes its rows, the head first, and by how much figures in it may
    differ from one machine to the next, as a share; 0 where they are counted.
    """

    page: str
    rows: Callable[[], Rows]
    within: float = 0.0


def phase_design(topology: Topology, *changes: str, control: str = "float32") -> Design:
    """The shipped drive of paper 002 in another topology, with its control in C."""
    settings = [f"export.control={control}", f"inverter.topology={topology}", *changes]
    if topology == "split-capacitor":
        settings.append("inverter.midpoint_capacitance=4 mF")
    return load_text(catalogue.read_text(PHASES), PHASES, None, settings)


@cache
def phase_solution(topology: Topology) -> Solution:
    """What is solved of it."""
    return solve(phase_design(topology))


def ripples(
    found: Solution, points: Sequence[tuple[float, float]], *, switched: bool
) -> list[float]:
    """Torque ripple in % of the torque of the emitted control, peak to peak: of the instantaneous
    torque with an averaged inverter without dead time, of the means per PWM period with a switched
    one and 1 us.

    Args:
        found: A solved phase machine.
        points: Speeds in rpm and torques in N m.
        switched: Which of both.
    """
    design = found.design
    assert design.phase_machine is not None
    drive = Drive(design.machine, design.inverter, design.control.t_s, 1, design.phase_machine)
    duration = 1.4 if switched else 0.8
    runs = [
        (
            drive,
            Scenario(
                duration, "torque", constant(torque), shaft=constant(rpm * np.pi / 30.0),
                omega_m=rpm * np.pi / 30.0, inverter="switched" if switched else "averaged",
                dead_time=1e-6 if switched else 0.0,
            ),
            b"",
        )
        for rpm, torque in points
    ]  # fmt: skip
    topology = design.inverter.topology
    with simulator(emitted_files(found), design.export.prefix, (), topology) as program:
        seen = simulate_many(program, runs, tail=1.0 - 0.4 / duration)
    sizes = seen.tail_ripple_means if switched else seen.tail_ripple
    return [100.0 * float(size) / torque for size, (_, torque) in zip(sizes, points, strict=True)]


def phase_ripple() -> Rows:
    """Torque ripple of the shipped drive with the emitted control, on five topologies."""
    yield ("topology", "averaged, 1 N m", "switched, 1 N m", "switched, 3.5 N m")
    for topology in ("three-wire", "four-leg", "six-leg", "six-leg-isolated", "split-capacitor"):
        found = phase_solution(topology)
        cells = []
        for switched, torque in ((False, 1.0), (True, 1.0), (True, 3.5)):
            values = ripples(found, [(rpm, torque) for rpm in SPEEDS], switched=switched)
            cells.append(" / ".join(f"{value:.2g}" for value in values))
        yield (topology, *cells)


def phase_nodes() -> Rows:
    """Nodes of the shipped drive's table, what they err by and take, and what is emitted."""
    found = phase_solution("four-leg")
    machine, loops = found.design.phase_machine, found.gains.phases
    assert loops is not None
    assert isinstance(machine, PhaseMachine)
    emitted = loops.control.shape.flux.shape[1]
    yield ("nodes", "torque error of the table, p-p", "averaged at 750 rpm, 1 N m", "bytes")
    for nodes in (48, 96, 120, 144, 192):
        shape = PhaseShape(resampled(machine.flux[:1], nodes))
        error, _ = shape_error(machine, shape, zero=True)
        control = replace(loops.control, shape=shape)
        gains = replace(found.gains, phases=replace(loops, control=control))
        (ripple,) = ripples(replace(found, loops=gains), [(750.0, 1.0)], switched=False)
        name = f"**{nodes}**, emitted" if nodes == emitted else f"{nodes}"
        yield (name, f"{100.0 * error:.2g} %", f"{ripple:.2g} %", f"{4 * (nodes + 1)}")


def fixed_phase_ripple() -> Rows:
    """Torque ripple of the emitted integers beside that of the emitted float32 control."""
    yield ("topology", "Q15: ripple", "Q15: mean torque", "float32: ripple")
    topologies: tuple[Topology, ...] = ("three-wire", "four-leg", "six-leg")
    for topology in topologies:
        design = phase_design(topology, control="q15")
        (fit,) = solve(design).fixed
        assert isinstance(fit, FixedPhaseFit)
        plant = near_sinusoidal(720)
        torque = Loop(plant, fit.control, 750.0 * np.pi / 30.0).torque(1.0, 0.0, 2400)[2000:]
        (ripple,) = ripples(phase_solution(topology), [(750.0, 1.0)], switched=False)
        yield (
            topology, f"{100.0 * np.ptp(torque):.2g} %", f"{np.mean(torque):.4f} N m",
            f"{ripple:.2g} %",
        )  # fmt: skip


def limited_waveforms() -> Rows:
    """Largest torques with and without limited waveforms, what their table takes and errs by."""
    yield (
        "topology, link", "speeds, size", "N m at 1800 / 1980 / 2160 rpm, plain",
        "with waveforms", "voltage beside its margins, nominal / 0.8", "torque error",
    )  # fmt: skip
    links: dict[Topology, float] = {
        "three-wire": 170.0, "four-leg": 170.0, "six-leg": 100.0, "split-capacitor": 170.0,
    }  # fmt: skip
    for topology, link in links.items():
        settings = [f"inverter.v_dc={link:g} V", "control.current_loop.limited_waveforms=true"]
        found = solve_gains(phase_design(topology, *settings)).phases
        assert found is not None
        control, fit = found.control, found.limited
        assert fit is not None
        assert control.torque_limit is not None
        omega = np.array([1800.0, 1980.0, 2160.0]) * np.pi / 30.0 * control.pole_pairs
        volts = np.full(omega.size, link)
        plain = limit_at(control.torque_limit, omega, volts)
        _, most = limited_torques(fit.shapes, omega, volts)
        yield (
            f"{topology}, {link:g} V",
            f"{fit.shapes.omega_e.size}, {fit.kilobytes:.0f} kB",
            " / ".join(f"{torque:.2f}" for torque in plain),
            " / ".join(f"{torque:.2f}" for torque in most),
            f"{100.0 * fit.excess:+.1f} / {100.0 * fit.excess_low:+.1f} %",
            f"{100.0 * fit.torque_error:.1f} %",
        )


_PHASE_STEP = """#include "{prefix}_control.h"

static {prefix}_control_t control_state;

static inline void control_step_at(float theta, float *first, float *last)
{{
    {prefix}_measured_t measured;

    measured.i.a = 0.5F;
    measured.i.b = -0.2F;
    measured.i.c = -0.3F;
    measured.theta_e = theta;
    measured.omega_m = 80.0F;
    measured.v_dc = 220.0F;
    {{
        const {prefix}_duties_t duty =
            {prefix}_torque_control(&{macro}_CONTROL_GAINS, &control_state, &measured, 1.0F);

        *first = duty.a;
        *last = duty.c;
    }}
}}
"""

_PHASE_CASES: tuple[tuple[Topology, tuple[str, ...]], ...] = (
    ("three-wire", ()),
    ("three-wire", ("harmonic_integrators=false",)),
    ("four-leg", ()),
    ("four-leg", ("harmonic_integrators=false",)),
    ("four-leg", ("frame=dqy",)),
)


def phase_cost() -> Rows:
    """One step of the emitted control at 64 angles."""
    yield ("step", *CORES.values())
    angles = np.linspace(-3.1, 3.1, 64).astype(np.float32)
    for topology, changes in _PHASE_CASES:
        named = (f"control.current_loop.{change}" for change in changes)
        found = solve(phase_design(topology, *named))
        prefix = found.design.export.prefix
        step = _PHASE_STEP.format(prefix=prefix, macro=prefix.upper())
        files = {name: text for name, text in emitted_files(found).items() if name[-2:] == ".h"}
        cells = []
        for core in CORES:
            sources = files | {"step.h": step.encode("ascii")}
            cost = cost_on_target(sources, "step.h", "control_step_at", core, angles)
            low, high = cost.cycles
            span = f"{low:.0f}" if round(low) == round(high) else f"{low:.0f}-{high:.0f}"
            cells.append(f"{cost.instructions:.0f} / {span} / {cost.flash}")
        yield (", ".join([topology, *(f"`{change}`" for change in changes)]), *cells)


def _interrupt_cell(cost: CallCost) -> str:
    (low, high), (_, most) = cost.cycles, cost.cycles_largest
    span = f"{low:.0f}" if round(low) == round(high) else f"{low:.0f}-{high:.0f}"
    return f"{cost.instructions:.0f} ({cost.instructions_largest}) / {span} ({most}) / {cost.flash}"


def interrupt_cost() -> Rows:
    """The whole interrupt and its parts, with the voltage within its limit and shortened."""
    yield ("function", *CORES.values())
    for step in interrupts():
        calls = {core: 16 if core == "cortex-m0plus" else 300 for core in CORES}
        costs = [step.cost(core, count) for core, count in calls.items()]
        yield (step.label, *(_interrupt_cell(cost) for cost in costs))


def observed_rule() -> Rows:
    """Speed loop of the template that is left to the rule, on each observer."""
    text = catalogue.template().decode().replace("    spread: 3\n", "")
    loops = []
    for method in METHODS:
        asked = text.replace("    pole: 400 rad/s\n", f"    method: {method}\n")
        loops.append(solve_gains(load_text(asked.encode(), "template.yaml")).speed)
    yield ("template, rule", *METHODS)
    margins, crossovers, spreads, speeds, steps = [], [], [], [], []
    for loop in loops:
        assert loop is not None
        assert loop.observed is not None
        assert loop.observed.corners is not None
        held = loop.observed.corners
        assert held.steps is not None
        margins.append(f"{np.degrees(loop.phase_margin):.1f}")
        crossovers.append(f"{loop.crossover:.0f}")
        spreads.append(f"{loop.observed.slowed or SPREAD:.2f}")
        rpm = 30.0 / np.pi / held.pole_pairs
        speeds.append(f"{rpm * held.binding.low:.0f} to {rpm * held.binding.high:.0f}")
        steps.append(f"{held.steps.load:.2f} from {rpm * held.steps.load_low:.0f} on")
    yield ("phase margin, deg", *margins)
    yield ("crossover, rad/s", *crossovers)
    yield ("spread", *spreads)
    yield ("every corner holds, rpm", *speeds)
    yield ("load step in N m that is withstood, rpm", *steps)


def closed_regulators() -> Rows:
    """Six regulators and the carrier in the closed drive: half of the largest torque at half of the
    base speed on two library drives.
    """
    yield (
        "drive", "regulator", "kHz", "THD, %", "torque ripple, N m", "copper, W", "ripple, W",
        "conduction, W", "switching, W", "all, W",
    )  # fmt: skip
    for name, settings in CLOSED_DRIVES.items():
        design = load_text(catalogue.read_text(name), name, None, settings)
        torque = 0.5 * float(mtpa_locus(design.machine, design.i_max).torque[-1])
        speed = 0.5 * design.control.bases.speed
        points = working_points(design, np.array([torque]), np.array([speed]))
        for regulator, (point,) in closed_loads(design, points).items():
            yield (
                name,
                regulator if regulator != "carrier" else point.name,
                f"{1e-3 * point.frequency:.3g}",
                f"{100.0 * point.distortion:.2g}",
                f"{point.torque_ripple:.2g}",
                f"{point.copper:.3g}",
                f"{point.ripple_copper:.2g}",
                f"{point.conduction:.3g}",
                f"{point.switching:.3g}",
                f"{point.total:.3g}",
            )


# Every table by its name.
NUMBERS: dict[str, Numbers] = {
    "phase-nodes": Numbers("methods/phase-control.md", phase_nodes, 0.2),
    "fixed-phase-ripple": Numbers("methods/fixed-point-control.md", fixed_phase_ripple, 0.2),
    "limited-waveforms": Numbers("methods/phase-control.md", limited_waveforms, 0.02),
    "phase-ripple": Numbers("methods/phase-control.md", phase_ripple, 0.2),
    "phase-cost": Numbers("methods/phase-control.md", phase_cost),
    "interrupt-cost": Numbers("reference/control-cost.md", interrupt_cost),
    "measuring": Numbers("how-to/measure-a-motor.md", measuring, 0.02),
    "observed-rule": Numbers("methods/observed-loops.md", observed_rule, 0.05),
    "parameter-estimators": Numbers("methods/online-estimation.md", parameter_estimators, 0.05),
    "speed-controllers": Numbers("methods/current-and-speed-loops.md", speed_controllers, 0.05),
    "closed-regulators": Numbers("methods/current-feedback-pwm.md", closed_regulators, 0.2),
    "sensorless-samples": Numbers(
        "methods/observed-loops.md", lambda: sensorless_samples.table(read(KEPT))
    ),
}


def made(name: str) -> list[str]:
    """Lines of a table."""
    head, *rows = [f"| {' | '.join(cells)} |" for cells in NUMBERS[name].rows()]
    return [head, "|" + "---|" * (head.count("|") - 1), *rows]


def marked(text: str, name: str) -> tuple[int, int]:
    """First line of a table in a page and the one behind its last, counted from 0."""
    lines = text.split("\n")
    first = lines.index(f"<!-- numbers: {name} -->") + 2
    last = first
    while last < len(lines) and lines[last].startswith("|"):
        last += 1
    return first, last


def said(name: str) -> list[str]:
    """Lines of the table as they stand in the page."""
    text = (DOCS / NUMBERS[name].page).read_text(encoding="utf-8")
    first, last = marked(text, name)
    return text.split("\n")[first:last]


def main(names: Sequence[str]) -> None:
    """Make tables and write them into their pages."""
    for name in names or NUMBERS:
        path, lines = DOCS / NUMBERS[name].page, made(name)
        text = path.read_text(encoding="utf-8")
        first, last = marked(text, name)
        whole = text.split("\n")
        path.write_text("\n".join([*whole[:first], *lines, *whole[last:]]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
