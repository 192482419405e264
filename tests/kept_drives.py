"""Drives whose emitted texts are kept (`kept_output`): few, and together they render every
template; each case gives texts by name, and compiles nothing.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args
from unittest import mock

import house
import jinja2
import numpy as np
from application_replay import design as program_design
from firmware_loops import VALUES, infineon, vesc
from fixed_drives import fitted, observed_design, tuned
from phase_loops import HARMONICS, page_control
from six_step_drives import bench

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import VerificationError
from dqforge.machines.names import FeedbackMethod, Firmware
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.estimators import TRACKERS
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.answers import dqy
from dqforge.reports.capability import Outcome, asked_for
from dqforge.reports.estimator_comparison import observer_errors, random_starts
from dqforge.reports.firmware.loop_code import loop_files
from dqforge.reports.fixed_observers.fixed_observer_header import fixed_observer_files
from dqforge.reports.main_header import header_files
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.paper000_load_test import method_sources
from dqforge.reports.papers.paper001_emitted_control import program_files
from dqforge.reports.run import export_design, solved_files
from dqforge.reports.simulation.recorded_run import simulation_sources
from dqforge.reports.single_headers.application import (
    APPLICATION,
    application_context,
    application_files,
)
from dqforge.reports.six_step.drive_run import simulate_six_step
from dqforge.reports.start_up.header import start_up_files
from dqforge.reports.verification import cortex_m
from dqforge.reports.verification.measured_cost import cost_on_target

BENCH, SHAPED = "paper001-pmsm-bench", "paper002-phase-waveforms"
Texts = Mapping[str, bytes | str]


def templates() -> list[str]:
    """Every template of a program or of a file for other firmware."""
    names = (path.relative_to(house.ROOT).as_posix() for path in house.ROOT.glob("reports/**/*.j2"))
    return sorted(name for name in names if not re.search(r"\.(html|js|css)\.j2$", name))


@contextmanager
def rendered() -> Iterator[dict[str, str]]:
    """Every template that is rendered meanwhile, those that another includes too, by its path;
    with the text that was last made of it, empty where it was included.
    """
    found: dict[str, str] = {}
    get, render = jinja2.Environment.get_template, jinja2.Template.render

    def path(name: object) -> str:
        room, _, rest = str(name).partition("/")
        return f"reports/{room}/templates/{rest}"

    def noted(self: jinja2.Environment, name: str, *more: Any, **named: Any) -> jinja2.Template:
        found.setdefault(path(name), "")
        return get(self, name, *more, **named)

    def kept(self: jinja2.Template, *values: Any, **named: Any) -> str:
        found[path(self.name)] = text = render(self, *values, **named)
        return text

    with (
        mock.patch.object(jinja2.Environment, "get_template", noted),
        mock.patch.object(jinja2.Template, "render", kept),
    ):
        yield found


def _exported(design: Design) -> Texts:
    return export_design(design, verify=False).files


def _library(name: str, *settings: str) -> Texts:
    return _exported(catalogue.load(name, list(settings)))


def _without_tools(run: Callable[[], object]) -> Texts:
    """What is rendered until a compiler is asked for."""
    with (
        rendered() as found,
        mock.patch.object(shutil, "which", return_value=None),
        suppress(VerificationError),
    ):
        run()
    return {Path(name).stem: text for name, text in found.items() if text}


def _of_each(kinds: Mapping[str, Texts]) -> Texts:
    """Texts under the names of kind and file; what an earlier kind has already is left out."""
    found: dict[str, bytes | str] = {}
    for kind, made in kinds.items():
        seen = set(found.values())
        found |= {f"{kind} {name}": text for name, text in made.items() if text not in seen}
    return found


def _simulated() -> Texts:
    """The plant with its main programme, for every switch of the templates."""
    whole = {
        "drive_startup.h": b"",
        "drive_start_observer.h": b" drive_injection_t;",
        "drive_online_estimation.h": b"",
        "drive_speed_measurement.h": b"_speed_measurement_edge(",
        "drive_control.h": b"*torque_limit;",
    }
    counts = {"drive_speed_measurement.h": b"", "drive_main.c": b"_torque_control_"}
    plain = {"drive.h": b""}
    both = ("flux", "reduced_order")

    def sources(files: Mapping[str, bytes] | None, *more: Any) -> Texts:
        return simulation_sources(files, "drive", *more)

    return _of_each(
        {
            "plant": sources(None),
            "whole": sources(whole, both, "split-capacitor"),
            "edges": sources(whole | {"drive_main.c": b""}, ("flux",)),
            "counts": sources(counts, ("reduced_order",), "four-leg"),
            "q15": sources(counts, both, "four-leg", "q15"),
            "q31": sources(plain, (), "split-capacitor", "q31"),
            "integers": sources(plain, ("flux",), None, "q15"),
            **{each.code: sources(plain, (each.code,)) for each in TRACKERS.values()},
            **{
                name: sources(plain, (), None, "float32", name)
                for name in ("carrier", *get_args(FeedbackMethod))
            },
        }
    )


def _programs() -> Texts:
    """Those around the functions; with each estimator from standstill on."""
    design = program_design("start-up")
    solution = solve(design)
    (plan,) = [found for _, found in asked_for((APPLICATION,), Outcome(solution))]
    context = application_context(solution, plan)
    assert solution.start_up is not None
    started = start_up_files(solution, solution.start_up)
    low = render("single_headers/application/application.h.j2", context | {"low": "injection"})
    return _of_each(
        {
            "start-up": application_files(solution, plan) | started,
            "low": {"application.h": low},
        }
    )


def _firmware() -> Texts:
    """Files of each firmware, and the loops of two of them in C."""
    sensing = "inverter.current_sensing={shunt: 10 mOhm, gain: 20, reference: 3.3 V}"
    design = catalogue.load(BENCH, [sensing])
    fits = {name: solved_files(design, (name,)) for name in get_args(Firmware)}
    loops = {profile.firmware: loop_files(profile, VALUES) for profile in (vesc(), infineon())}
    files = {name: dict(files) for name, ((_, files),) in fits.items()}
    return _of_each({**files, **{f"loops of {name}": made for name, made in loops.items()}})


def _six_step() -> Texts:
    found = {}
    for method in ("zero-crossing", "diode-conduction"):
        design = bench(f"control.observer.method={method}")
        run = _without_tools(partial(simulate_six_step, design))
        found[method] = {**_exported(design), **run}
    return _of_each(found)


def _estimators() -> Texts:
    """The programs of the comparison of estimators, and those of what a sample costs."""
    design = observed_design("flux")
    asked = SimpleNamespace(design=design, omega_max=1000.0)
    figures = SimpleNamespace(tracker=None, observer=tuned("flux"))
    shaped = catalogue.load(SHAPED)
    solution = solve(shaped)
    compared = SimpleNamespace(omega_m=50.0, v_dc=200.0, torque=1.0)
    rows: dict[str, Any] = {
        topology: SimpleNamespace(
            control=page_control("dq", topology=topology, harmonics=HARMONICS), topology=topology
        )
        for topology in ("three-wire", "split-capacitor")
    }
    any_: Any = observer_errors, dqy
    return _of_each(
        {
            "cost": _without_tools(lambda: any_[0]._cost(asked, figures)),
            **{
                name: _without_tools(partial(any_[1]._cycles, solution, compared, row))
                for name, row in rows.items()
            },
            "starts": random_starts._sources("drive", "flux", "injection", shared=True),
            "own starts": random_starts._sources("drive", "flux", "", shared=False),
        }
    )


def _papers() -> Texts:
    machine = catalogue.load("paper000-ipmsm-100kw").machine
    assert isinstance(machine, LinearMachine)
    headers = {"only.h": b"", "fixed.h": b""}
    return _of_each(
        {
            "000": method_sources(machine, headers, "only", "fixed"),
            "001": program_files(catalogue.load(BENCH)),
        }
    )


def _on_target() -> Texts:
    board = {"flash": 0, "ram": 536870912, "ram_size": 65536}
    run: Any = cortex_m
    return _of_each(
        {
            "vectors": _without_tools(lambda: run._run_vectors({}, "drive", "cortex-m4", ["q15"])),
            "board": {"target.ld": render("verification/target.ld.j2", board)},
            "cost": _without_tools(
                lambda: cost_on_target(
                    {}, "drive.h", "f", "cortex-m4", np.array([0.0, 1.5], dtype=np.float32)
                )
            ),
        }
    )


def _observers(*methods: str) -> Texts:
    """Observers in floats and in both widths of integers."""
    return _of_each(
        {
            method: {
                **observer_files(observed_design(method), tuned(method)),
                **fixed_observer_files(observed_design(method), fitted(method, 32)),
                **fixed_observer_files(observed_design(method), fitted(method, 16)),
            }
            for method in methods
        }
    )


def _fitted() -> Texts:
    """Current references by each method, on breakpoints that are searched and on given ones."""
    found = {}
    for method, mode, name in (
        ("minimax", "shared", "paper000-ipmsm-100kw"),
        ("least-squares", "own", "abb-ipmsm-2k2"),
        ("lagrange", "shared", "abb-ipmsm-2k2"),
    ):
        settings = [f"fit.method={method}", f"fit.breakpoint_mode={mode}", "fit.form=polynomial"]
        design = catalogue.load(name, [*settings, "fit.segments=3", "fit.degree=3"])
        fit = solve_fit(design).fit
        made = Solution(design, solve_curves(design), fit, (), None, None)
        found[method] = header_files(made)
    return _of_each(found)


def _shaped(*settings: str) -> Callable[[], Texts]:
    return lambda: _library(SHAPED, *settings)


# What is quick stands first: it is asked first.
CASES: dict[str, Callable[[], Texts]] = {
    "simulation": _simulated,
    "papers": _papers,
    "on-target": _on_target,
    "six-step": _six_step,
    "edges": lambda: _exported(program_design("edges")),
    "counts": lambda: _exported(program_design("counts")),
    "observed": lambda: _exported(program_design("observer")),
    "float32": lambda: _library(
        BENCH,
        "export.control=float32",
        "control.commissioning={}",
        "control.online_estimation={}",
        "operation.overmodulation=least-phase-error",
    ),
    "q15": lambda: _library(BENCH, "export.control=q15", "fit.format=q15"),
    "q31": lambda: _library(BENCH, "export.control=q31", "fit.format=q31"),
    "shaped-q15": _shaped(
        "export.control=[float32, q15]",
        "inverter.topology=split-capacitor",
        "inverter.midpoint_capacitance=1 mF",
        "control.current_loop.frame=dqy",
    ),
    "shaped-q31": _shaped(
        "export.control=[float32, q31]",
        "control.current_loop.harmonic_integrators=true",
        "control.current_loop.feedforward=none",
        "control.speed_loop={method: bandwidth, bandwidth: 12 rad/s, ratio: 10}",
        "export.frame_tables=true",
    ),
    "fitted": _fitted,
    "estimators": _estimators,
    "firmware": _firmware,
    "flux-observer": lambda: _observers("flux", "extended-emf"),
    "voltage-observer": lambda: _observers("matsui-voltage"),
    "sliding-observer": lambda: _observers("smo"),
    "limited": _shaped(
        "control.current_loop.limited_waveforms=true",
        "export.control=float32",
        "inverter.topology=three-wire",
        "inverter.v_dc=170 V",
    ),
    "start-up": _programs,
}
